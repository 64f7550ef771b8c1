"""Sensor faults and checks: what attacks, faults and defences make of sensor readings, between world and engines.

Each sensor fault alters a copy of its vehicles' rows, in order of attack and name, those that are
`first` before the others; the checks of defences come last.
What an attack that acts has written is kept and passed on, to later sensor faults and to the engines. An engine none of
whose vehicles is altered gets the world's own arrays. The arrays of the copies are the same at every tick, because
readings are valid until the next one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields
from operator import attrgetter, is_
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import (
    READINGS_NS,
    Floats,
    ReadingsTracker,
    ReceivedSensors,
    SensorHook,
    Sensors,
    World,
)
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
_FIXES = tuple(name for name in _ARRAYS if name.startswith("gnss_"))
"""What a receiver tells with a fix."""
_INTEGRALS = ("delta_angle_rad", "delta_velocity_mps")
"""What follows from other readings."""
Rows = slice | NDArray[np.int64]
_ALL = slice(None)


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
        self.per_fix = self.slow and all(
            getattr(fault, "per_fix", False) or (attack.muted and not attack.plan.is_defence) for attack, fault in owned
        )
        """Whether what each of those that are called in a batch does changes with new fixes only."""
        self.inert = all(attack.muted and not attack.plan.is_defence for attack, _ in owned)
        """Whether none of them can have an effect, because all are muted and no defences."""
        self.trackers: list[tuple[NDArray[np.int64], ReadingsTracker]] = [
            (np.array([vehicles.index(vehicle) for vehicle in fault.vehicles], dtype=np.int64), tracker)
            for _, fault in owned
            if (tracker := getattr(fault, "tracker", None)) is not None
        ]
        """Trackers of its checks, with the rows of their vehicles."""
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
        self._acted = False
        """Whether one of them has an effect on the readings at this tick."""

    def apply(self, now: Time, world: World) -> list[tuple[ActState, SensorHook, FrameId | Alert]]:
        """Apply every sensor fault to this tick's readings; returns each act that takes effect, by an id of its own.

        Alerts are among them. The order of the checks of defences is that of their plans.
        """
        if self.slow and self._readings.filled and now % READINGS_NS >= world.quantum_ns:
            self._readings.refresh(world.sensors(self._rows))
            return []
        sensors = world.sensors(self._rows)
        numbered_acts = self._call_hooks(now, self._readings.fill(sensors), skip_muted=False)
        if self.slow and self._acted:
            self._check_slow(self._readings.table, sensors)
        return numbered_acts

    def share(self, shared: Sensors, first: int) -> None:
        """Work on the readings of a batch from now on, in which the rows of this run begin at `first`."""
        self._readings.share(shared, self._rows, first)

    def apply_shared(self, now: Time) -> list[tuple[ActState, SensorHook, FrameId | Alert]]:
        """As `apply`, on readings of a batch that have just been filled.

        A muted attack or fault is not called: whatever it would have done is discarded.
        """
        numbered_acts = self._call_hooks(now, self._readings.gather(), skip_muted=True)
        self._readings.scatter()
        return numbered_acts

    def _call_hooks(
        self, now: Time, table: Sensors, *, skip_muted: bool
    ) -> list[tuple[ActState, SensorHook, FrameId | Alert]]:
        numbered_acts: list[tuple[ActState, SensorHook, FrameId | Alert]] = []
        acted = False
        for place, (attack, fault, places) in enumerate(self._owned):
            if place == self._first_check and self._integrals is not None:
                self._integrals.update(now, table)
            acts = takes_effect(attack, now)
            if skip_muted and attack.muted and not attack.plan.is_defence:
                continue
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
                numbered_acts += [(attack, fault, act) for act in numbered]
        self._acted = acted
        return numbered_acts

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
            return not self._muted.equals(self._readings)
        table = _arrays_of(self._readings.table)
        return any(
            array.tobytes() != other[places].tobytes() for array, other in zip(_arrays_of(rows), table, strict=True)
        )

    @property
    def received(self) -> ReceivedSensors | None:
        """The readings of the vehicles of all sensor faults, as these left them at this tick; `None` before one."""
        return ReceivedSensors(self._rows, self._readings.shown) if self._readings.filled else None

    def alter(self, rows: Rows, sensors: Sensors) -> Sensors:
        """An engine's sensor readings with what the sensor faults have made of them; `rows` are its world rows."""
        slot = next((candidate for candidate in self._slots if candidate.rows is rows), None) or self._add_slot(rows)
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


class BatchSensorHooks:
    """The sensor faults of all runs of a batch, which work on readings that they share. Never copied.

    The sensor faults of a run that all are `per_fix` are called when one of its aircraft has a new fix, or when one of
    them begins or ends: in between, what they have written of fixes stays. Trackers of these runs are joined.
    """

    def __init__(self, runs: Sequence[tuple[slice, SensorHookInjector]], bodies: int) -> None:
        """`runs` with sensor faults: the world rows of each, and the sensor faults; `bodies` are those of the world."""
        self._runs = runs
        self._table: Sensors | None = None
        self._shown: Sensors | None = None
        self._slow = all(hooks.slow for _, hooks in runs)
        self._run_of = np.full(bodies, len(runs), dtype=np.int64)
        """(bodies,) The place of each one's run in `runs`, or their number."""
        for place, (rows, _) in enumerate(runs):
            self._run_of[rows] = place
        self._per_fix = np.array([*(hooks.per_fix for _, hooks in runs), False])
        self._inert = np.array([*(hooks.inert for _, hooks in runs), True])
        self._changed = np.ones(bodies, dtype=np.bool_)
        self._fixes: list[NDArray[Any]] = []
        self._trackers = _join_trackers(runs)
        self._hidden: Floats = np.full((bodies, 3), np.nan)

    def expire(self) -> None:
        """Have all sensor faults called at the next tick, because some may begin or end there."""
        self._changed[:] = True

    def apply(
        self, now: Time, world: World
    ) -> Iterator[tuple[int, list[tuple[ActState, SensorHook, FrameId | Alert]]]]:
        """What sensor faults do to this tick's readings, as `SensorHookInjector.apply`: by place of the run."""
        sensors = world.sensors(slice(None))
        if self._table is None:
            self._allocate(sensors)
        table = self._table
        assert table is not None
        if self._slow and self._fixes and now % READINGS_NS >= world.quantum_ns:
            for name in _FAST:
                getattr(table, name)[...] = getattr(sensors, name)
            return
        due = self._copy(sensors, table)
        if self._trackers:
            self._track(now, sensors)
        for place in due.tolist():
            acts = self._runs[place][1].apply_shared(now)
            if acts:
                yield place, acts
        if self._slow and not _same_fast(table, sensors):  # flown alone, the run whose fault it is names it
            raise ComponentError("sensor faults", "altered what changes at every tick, although they are slow")

    def _track(self, now: Time, sensors: Sensors) -> None:
        """Show trackers the readings of their rows, which no sensor fault of their runs alters, but for fixes."""
        readings = dict(zip(_ARRAYS, _arrays_of(sensors), strict=True)) | {"attitude": self._hidden}
        for rows, tracker in self._trackers:
            tracker.update(now, Sensors(**{name: array[rows] for name, array in readings.items()}))

    def _copy(self, sensors: Sensors, table: Sensors) -> NDArray[np.int64]:
        """Take this tick's readings, but for fixes that stay as they were altered; returns whose faults are due."""
        changed = self._changed
        for kept, name in zip(self._fixes, _FIXES, strict=False):
            now = getattr(sensors, name)
            differ = now != kept  # what is not a number differs from itself
            changed |= differ if differ.ndim == 1 else differ.any(axis=1)
        self._fixes = [getattr(sensors, name).copy() for name in _FIXES]
        count = len(self._runs)
        is_due = np.bincount(self._run_of[changed], minlength=count + 1)[: count + 1] > 0
        is_due |= ~self._per_fix
        is_due &= ~self._inert
        held = (self._per_fix & ~is_due & ~self._inert)[self._run_of]
        for name in _ARRAYS:
            mine, theirs = getattr(table, name), getattr(sensors, name)
            if name in _FIXES and held.any():
                np.copyto(mine, theirs, where=~held if mine.ndim == 1 else ~held[:, None])
            else:
                mine[...] = theirs
        changed[:] = False
        return np.flatnonzero(is_due[:count])

    def alter(self, rows: Rows = _ALL) -> Sensors:
        """The readings of some bodies, by default of all, as their engine receives them."""
        assert self._shown is not None
        if isinstance(rows, slice) and rows.start in (None, 0) and rows.stop in (None, len(self._run_of)):
            return self._shown
        return Sensors(*[array[rows] for array in _arrays_of(self._shown)])

    def _allocate(self, sensors: Sensors) -> None:
        self._table = Sensors(*[np.array(array) for array in _arrays_of(sensors)])
        self._shown = Sensors(*map(as_read_only, _arrays_of(self._table)))
        for rows, hooks in self._runs:
            hooks.share(self._table, rows.start)


def _join_trackers(
    runs: Sequence[tuple[slice, SensorHookInjector]],
) -> list[tuple[NDArray[np.int64], ReadingsTracker]]:
    """The trackers of the runs whose sensor faults all are `per_fix`, joined by class, with their rows of the world."""
    by_class: dict[type, list[tuple[NDArray[np.int64], ReadingsTracker]]] = {}
    for rows, hooks in runs:
        for own_rows, tracker in hooks.trackers if hooks.per_fix else ():
            by_class.setdefault(type(tracker), []).append((rows.start + own_rows, tracker))
    joined = []
    for members in by_class.values():
        first, *others = (tracker for _, tracker in members)
        joined.append((np.concatenate([rows for rows, _ in members]), first.join(others)))
    return joined


def _same_fast(table: Sensors, sensors: Sensors) -> bool:
    """Whether what changes at every tick, or follows from it, is what the world's sensors read."""
    return all(getattr(table, name).tobytes() == getattr(sensors, name).tobytes() for name in (*_FAST, *_INTEGRALS))


class _Readings:
    """Sensor readings in arrays that are filled anew at each tick, one behind the other in memory. Deep-copyable."""

    __slots__ = ("_bytes", "_shared", "_shown", "_table")

    def __init__(self) -> None:
        self._shared: tuple[Sensors, Rows] | None = None
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

    def share(self, shared: Sensors, rows: Rows, first: int) -> None:
        """Be some rows of the readings of a batch, `rows` after the `first`: views where they follow each other."""
        if isinstance(rows, slice):
            place = slice(first + rows.start, first + rows.stop)
            self._table = Sensors(*[array[place] for array in _arrays_of(shared)])
        else:
            self._shared = shared, rows + first

    def gather(self) -> Sensors:
        """The rows of the batch that these readings are."""
        if self._shared is None:
            return self.table
        shared, rows = self._shared
        return self.fill(Sensors(*[array[rows] for array in _arrays_of(shared)]))

    def scatter(self) -> None:
        """Put them back into the batch, where they are no views of it."""
        if self._shared is not None:
            shared, rows = self._shared
            for array, altered in zip(_arrays_of(shared), _arrays_of(self.table), strict=True):
                array[rows] = altered

    def fill(self, sensors: Sensors) -> Sensors:
        """Copy `sensors`; returns the copy, whose arrays are those of the last call."""
        table = self._table or self._allocate(_arrays_of(sensors))
        for own_array, array in zip(_arrays_of(table), _arrays_of(sensors), strict=True):
            own_array[...] = array
        return table

    def copy(self, other: _Readings) -> Sensors:
        """Copy other readings at once; returns the copy, whose arrays are those of the last call."""
        if not len(other._bytes):  # views of others
            return self.fill(other.table)
        table = self._table or self._allocate(_arrays_of(other.table))
        self._bytes[:] = other._bytes
        return table

    def equals(self, other: _Readings) -> bool:
        """Whether they are the same to the bit."""
        if len(self._bytes) and len(other._bytes):
            return self._bytes.tobytes() == other._bytes.tobytes()
        pairs = zip(_arrays_of(self.table), _arrays_of(other.table), strict=True)
        return all(array.tobytes() == its.tobytes() for array, its in pairs)

    def _allocate(self, arrays: Sequence[NDArray[Any]]) -> Sensors:
        ends = np.cumsum([-(-array.nbytes // _ALIGNED) * _ALIGNED for array in arrays]).tolist()
        self._bytes = np.zeros(ends[-1], dtype=np.uint8)
        starts = [0, *ends[:-1]]
        places = [self._bytes[start : start + array.nbytes] for start, array in zip(starts, arrays, strict=True)]
        views = [place.view(array.dtype).reshape(array.shape) for place, array in zip(places, arrays, strict=True)]
        self._table = Sensors(*views)
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
