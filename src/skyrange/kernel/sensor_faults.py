"""Sensor faults and checks: what attacks, faults and defences make of sensor readings, between world and engines.

Each sensor fault alters a copy of its vehicles' rows, in order of attack and name; the checks of defences come last.
What an attack that acts has written is kept and passed on, to later sensor faults and to the engines. An engine none of
whose vehicles is altered gets the world's own arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import SensorFault, Sensors, World
from skyrange.core.errors import attribute_error
from skyrange.core.ids import FrameId
from skyrange.core.time import Time
from skyrange.kernel.attack_states import AttackState, takes_effect
from skyrange.kernel.fault_acts import ActCounter, check_faults

_ARRAYS = tuple(field.name for field in fields(Sensors))
Rows = slice | NDArray[np.int64]


class SensorFaultInjector:
    """The sensor faults of all attacks of one kernel."""

    def __init__(self, attacks: Sequence[AttackState], world: World | None) -> None:
        """Raises `InputError` for a vehicle that the world does not have, or a name used twice."""
        owned = [(attack, fault) for attack in attacks for fault in attack.plan.faults]
        owned.sort(key=_order_of)
        vehicles = list(world.vehicles) if world is not None else []
        check_faults("sensor fault", owned, vehicles)
        altered = sorted({vehicles.index(vehicle) for _, fault in owned for vehicle in fault.vehicles})
        self.present = bool(owned)
        """Whether there are any."""
        self._rows = np.array(altered, dtype=np.int64)
        self._place = np.full(len(vehicles), -1, dtype=np.int64)
        self._place[self._rows] = np.arange(len(altered))
        self._owned: list[tuple[AttackState, SensorFault, NDArray[np.int64] | None]] = []
        """With the places of its vehicles among the altered ones; `None` if these are all of them, in order."""
        for attack, fault in owned:
            places = self._place[np.array([vehicles.index(v) for v in fault.vehicles], dtype=np.int64)]
            self._owned.append((attack, fault, None if _is_whole(places, len(altered)) else places))
        self._acts = ActCounter("sensor fault")
        self._readings: Sensors | None = None

    def apply(self, now: Time, world: World) -> list[tuple[AttackState, SensorFault, FrameId | Alert]]:
        """Apply every sensor fault to this tick's readings; returns each act that takes effect, by an id of its own.

        Alerts are among them. The order of the checks of defences is that of their plans.
        """
        table = _copy(world.sensors(self._rows))
        found: list[tuple[AttackState, SensorFault, FrameId | Alert]] = []
        for attack, fault, places in self._owned:
            rows = _copy(table) if places is None else Sensors(*(getattr(table, name)[places] for name in _ARRAYS))
            attitude = rows.attitude
            if attack.plan.defence:
                rows.attitude = np.full_like(attitude, np.nan)
            try:
                done = list(fault.on_sensors(now, rows))
            except Exception as error:
                raise attribute_error(f"sensor fault {fault.name}", now, error) from error
            if takes_effect(attack, now):
                if attack.plan.defence:
                    rows.attitude = attitude
                if places is None:
                    table = rows
                else:
                    for name in _ARRAYS:
                        getattr(table, name)[places] = getattr(rows, name)
                acts = (act if isinstance(act, Alert) else self._acts.number(fault, *act) for act in done)
                found += [(attack, fault, act) for act in acts]
        self._readings = table
        return found

    def alter(self, rows: Rows, sensors: Sensors) -> Sensors:
        """An engine's sensor readings with what the sensor faults have made of them; `rows` are its world rows."""
        places = self._place[rows]
        hit = np.flatnonzero(places >= 0)
        if not len(hit):
            return sensors
        assert self._readings is not None
        if _is_whole(places, len(self._rows)):  # all that is altered, and nothing else
            for name in _ARRAYS:
                getattr(self._readings, name).flags.writeable = False
            return self._readings
        sensors = _copy(sensors)
        for name in _ARRAYS:
            array = getattr(sensors, name)
            array[hit] = getattr(self._readings, name)[places[hit]]
            array.flags.writeable = False
        return sensors


def _order_of(owned: tuple[AttackState, SensorFault]) -> tuple[bool, str, str]:
    """By attack and name; those of defences last, as they were given."""
    attack, fault = owned
    return (True, "", "") if attack.plan.defence else (False, attack.id, fault.name)


def _is_whole(places: NDArray[np.int64], count: int) -> bool:
    """Whether `places` are 0 to `count` - 1 in order."""
    return len(places) == count and bool((places == np.arange(count)).all())


def _copy(sensors: Sensors) -> Sensors:
    return Sensors(*(np.array(getattr(sensors, name)) for name in _ARRAYS))
