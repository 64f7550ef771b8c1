"""Sensor faults and checks: what attacks, faults and defences make of sensor readings, between world and engines.

Each sensor fault alters a copy of its vehicles' rows, in order of attack and name, those that are
`first` before the others; the checks of defences come last.
What an attack that acts has written is kept and passed on, to later sensor faults and to the engines. An engine none of
whose vehicles is altered gets the world's own arrays. The arrays of the copies are the same at every tick, because
readings are valid until the next one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from operator import attrgetter, is_
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import READINGS_NS, Floats, ReceivedSensors, SensorHook, Sensors, World
from skyrange.core.arrays import as_read_only
from skyrange.core.errors import ComponentError, attribute_error
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S, Time
from skyrange.kernel.acts.act_states import ActCounter, ActState, check_faults, note_withheld, takes_effect

_ARRAYS = tuple(field.name for field in fields(Sensors))
_arrays_of = attrgetter(*_ARRAYS)
_ALIGNED = 8
"""Bytes: each array begins at a multiple, as processors want it."""
_FAST = ("gyro_radps", "accel_mps2", "attitude", "rotor_radps")
"""What changes at every tick."""
_INTEGRALS = ("delta_angle_rad", "delta_velocity_mps")
"""What follows from other readings."""
Rows = slice | NDArray[np.int64]


class SensorHookInjector:
    """The sensor faults of all attacks of one kernel."""

    def __init__(self, attacks: Sequence[ActState], world: World | None) -> None:
        """Raises `InputError` for a vehicle that the world does not have, or a name used twice."""
        owned = [(attack, fault) for attack in attacks for fault in attack.plan.sensor_hooks]
        owned.sort(key=_order_of)
        vehicles = list(world.vehicles) if world is not None else []
        check_faults("sensor fault", owned, vehicles)
        altered = sorted({vehicles.index(vehicle) for _, fault in owned for vehicle in fault.vehicles})
        self.present = bool(owned)
        """Whether there are any."""
        self.slow = all(getattr(fault, "slow", False) for _, fault in owned)
        """Whether each of them needs to be called at new readings only; to be cleared where engines read in between."""
        self._count = len(altered)
        self._rows: Rows = np.array(altered, dtype=np.int64)
        self._place = np.full(len(vehicles), -1, dtype=np.int64)
        self._place[self._rows] = np.arange(len(altered))
        if altered and altered[-1] - altered[0] + 1 == len(altered):
            self._rows = slice(altered[0], altered[-1] + 1)
        self._owned: list[tuple[ActState, SensorHook, NDArray[np.int64] | None]] = []
        """With the places of its vehicles among the altered ones; `None` if these are all of them, in order."""
        for attack, fault in owned:
            places = self._place[np.array([vehicles.index(v) for v in fault.vehicles], dtype=np.int64)]
            self._owned.append((attack, fault, None if _is_whole(places, len(altered)) else places))
        self._acts = ActCounter("sensor fault")
        self._readings = _Readings()
        """Of the altered vehicles, as the last sensor fault left them."""
        self._muted = _Readings()
        """What a sensor fault that does not act may write into."""
        self._hidden: Floats | None = None
        checks = [place for place, (attack, _, _) in enumerate(self._owned) if attack.plan.is_defence]
        self._first_check = checks[0] if checks else len(self._owned)
        self._integrals: _Integrals | None = None
        """Of the readings that attacks and faults leave; `None` where none can alter them, or no check reads them."""
        if checks and any(not getattr(fault, "slow", False) for _, fault, _ in self._owned[: checks[0]]):
            self._integrals = _Integrals(len(altered))
        self._slots: list[_Slot] = []

    def apply(self, now: Time, world: World) -> list[tuple[ActState, SensorHook, FrameId | Alert]]:
        """Apply every sensor fault to this tick's readings; returns each act that takes effect, by an id of its own.

        Alerts are among them. The order of the checks of defences is that of their plans.
        """
        if self.slow and self._readings.filled and now % READINGS_NS >= world.quantum_ns:
            self._readings.refresh(world.sensors(self._rows))
            return []
        sensors = world.sensors(self._rows)
        table = self._readings.fill(sensors)
        found: list[tuple[ActState, SensorHook, FrameId | Alert]] = []
        acted = False
        for place, (attack, fault, places) in enumerate(self._owned):
            if place == self._first_check and self._integrals is not None:
                self._integrals.update(now, table)
            acts = takes_effect(attack, now)
            if places is not None:
                rows = Sensors(*[array[places] for array in _arrays_of(table)])
            else:
                rows = table if acts else self._muted.copy(self._readings)
            attitude = rows.attitude
            if attack.plan.is_defence:
                rows.attitude = self._hide(attitude)
            before = _arrays_of(rows)
            try:
                done = list(fault.on_sensors(now, rows))
                if not all(map(is_, before, _arrays_of(rows))):
                    _put_back(rows, before)
            except Exception as error:
                raise attribute_error(f"sensor fault {fault.name}", now, error) from error
            rows.attitude = attitude
            if attack.muted and attack.plan.is_defence and not attack.withheld and (done or self._differ(rows, places)):
                note_withheld(attack, now)
            if acts:
                acted = True
                if places is not None:
                    for kept, altered in zip(_arrays_of(table), _arrays_of(rows), strict=True):
                        kept[places] = altered
                numbered = (act if isinstance(act, Alert) else self._acts.number(fault, *act) for act in done)
                found += [(attack, fault, act) for act in numbered]
        if self.slow and acted:
            self._check_slow(table, sensors)
        return found

    def _check_slow(self, table: Sensors, sensors: Sensors) -> None:
        """Raise `ComponentError` where faults that call themselves slow have altered what changes at every tick, or
        what follows from it.
        """
        for name in (*_FAST, *_INTEGRALS):
            if getattr(table, name).tobytes() != getattr(sensors, name).tobytes():
                who = ", ".join(fault.name for _, fault, _ in self._owned)
                raise ComponentError(
                    f"sensor fault {who}",
                    f"altered {name}, which changes at every tick, although it is slow",
                    "Take out slow = True",
                )

    def _hide(self, attitude: Floats) -> Floats:
        """An attitude that is not a number, for as many vehicles; the same array each time, where it is not written."""
        hidden = self._hidden
        if hidden is None or hidden.shape != attitude.shape:
            hidden = self._hidden = np.empty_like(attitude)
        hidden.fill(np.nan)
        return hidden

    def _differ(self, rows: Sensors, places: NDArray[np.int64] | None) -> bool:
        """Whether what a muted sensor check was handed is now another than the readings."""
        if places is None:
            return self._muted.tobytes() != self._readings.tobytes()
        table = _arrays_of(self._readings.table)
        return any(one.tobytes() != other[places].tobytes() for one, other in zip(_arrays_of(rows), table, strict=True))

    @property
    def received(self) -> ReceivedSensors | None:
        """The readings of the vehicles of all sensor faults, as these left them at this tick; `None` before one."""
        return ReceivedSensors(self._rows, self._readings.shown) if self._readings.filled else None

    def alter(self, rows: Rows, sensors: Sensors) -> Sensors:
        """An engine's sensor readings with what the sensor faults have made of them; `rows` are its world rows."""
        slot = next((one for one in self._slots if one.rows is rows), None) or self._add_slot(rows)
        if not len(slot.hit):
            return sensors
        if slot.whole:
            return self._readings.shown
        sensors = Sensors(*[array.copy() for array in _arrays_of(sensors)])
        for array, altered in zip(_arrays_of(sensors), _arrays_of(self._readings.shown), strict=True):
            array[slot.hit] = altered[slot.places]
            array.setflags(write=False)
        return sensors

    def _add_slot(self, rows: Rows) -> _Slot:
        places = self._place[rows]
        hit = np.flatnonzero(places >= 0)
        slot = _Slot(rows, hit, places[hit], _is_whole(places, self._count))
        self._slots.append(slot)
        return slot


class _Readings:
    """Sensor readings in arrays that are filled anew at each tick, one behind the other in memory. Deep-copyable."""

    __slots__ = ("_bytes", "_shown", "_table")

    def __init__(self) -> None:
        self._bytes: NDArray[np.uint8] = np.zeros(0, dtype=np.uint8)
        self._table: Sensors | None = None
        self._shown: Sensors | None = None

    @property
    def table(self) -> Sensors:
        """The arrays."""
        assert self._table is not None
        return self._table

    @property
    def shown(self) -> Sensors:
        """Read-only views."""
        if self._shown is None:
            self._shown = Sensors(*map(as_read_only, _arrays_of(self.table)))
        return self._shown

    @property
    def filled(self) -> bool:
        """Whether there are any."""
        return self._table is not None

    def refresh(self, sensors: Sensors) -> None:
        """Copy what changes at every tick."""
        for name in _FAST:
            getattr(self.table, name)[...] = getattr(sensors, name)

    def fill(self, sensors: Sensors) -> Sensors:
        """Copy `sensors`; returns the copy, whose arrays are those of the last call."""
        table = self._table or self._allocate(_arrays_of(sensors))
        for mine, array in zip(_arrays_of(table), _arrays_of(sensors), strict=True):
            mine[...] = array
        return table

    def copy(self, other: _Readings) -> Sensors:
        """Copy other readings at once; returns the copy, whose arrays are those of the last call."""
        table = self._table or self._allocate(_arrays_of(other.table))
        self._bytes[:] = other._bytes
        return table

    def tobytes(self) -> bytes:
        """All of them, to be compared."""
        return self._bytes.tobytes()

    def _allocate(self, arrays: Sequence[NDArray[Any]]) -> Sensors:
        ends = np.cumsum([-(-array.nbytes // _ALIGNED) * _ALIGNED for array in arrays]).tolist()
        self._bytes = np.zeros(ends[-1], dtype=np.uint8)
        starts = [0, *ends[:-1]]
        places = [self._bytes[start : start + array.nbytes] for start, array in zip(starts, arrays, strict=True)]
        own = [place.view(array.dtype).reshape(array.shape) for place, array in zip(places, arrays, strict=True)]
        self._table = Sensors(*own)
        return self._table

    def __getstate__(self) -> Any:
        """Copies of the arrays: views would not stay views of the same memory."""
        return (None if self._table is None else [array.copy() for array in _arrays_of(self._table)],)

    def __setstate__(self, state: Any) -> None:
        self.__init__()  # type: ignore[misc]
        if state[0] is not None:
            self.fill(Sensors(*state[0]))


class _Integrals:
    """Integrals of altered inertial readings, as the world's sensors have them of their own. Deep-copyable."""

    __slots__ = ("_last_ns", "_shown", "_sums")

    def __init__(self, count: int) -> None:
        self._last_ns: Time | None = None
        self._sums = np.zeros((count, 6))
        self._shown = np.zeros((count, 6))

    def update(self, now: Time, table: Sensors) -> None:
        """Integrate the readings of a tick, and put the integrals that are due into them."""
        last, self._last_ns = self._last_ns, now
        step_s = 0.0 if last is None else (now - last) / NS_PER_S
        self._sums[:, :3] += table.gyro_radps * step_s
        self._sums[:, 3:] += table.accel_mps2 * step_s
        if last is None or now // READINGS_NS != last // READINGS_NS:
            self._shown[:] = self._sums
            self._sums[:] = 0.0
        table.delta_angle_rad[:] = self._shown[:, :3]
        table.delta_velocity_mps[:] = self._shown[:, 3:]


class _Slot(NamedTuple):
    """Where the altered readings are among those of an engine with these world rows."""

    rows: Rows
    hit: NDArray[np.int64]
    """Places of altered vehicles among the engine's."""
    places: NDArray[np.int64]
    """Places of the same vehicles among all altered ones."""
    whole: bool
    """Whether the engine's vehicles are all that is altered, and nothing else is."""


def _order_of(owned: tuple[ActState, SensorHook]) -> tuple[int, str, str]:
    """Those that are `first`, then by attack and name; those of defences last, as they were given."""
    attack, fault = owned
    if attack.plan.is_defence:
        return (2, "", "")
    return (0 if getattr(fault, "first", False) else 1, attack.id, fault.name)


def _is_whole(places: NDArray[np.int64], count: int) -> bool:
    """Whether `places` are 0 to `count` - 1 in order."""
    return len(places) == count and bool((places == np.arange(count)).all())


def _put_back(sensors: Sensors, arrays: Sequence[NDArray[Any]]) -> None:
    """Have `sensors` hold `arrays` again, filled with what it holds instead of them."""
    for name, array in zip(_ARRAYS, arrays, strict=True):
        array[...] = getattr(sensors, name)
        setattr(sensors, name, array)
