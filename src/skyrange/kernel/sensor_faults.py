"""Sensor faults: what the attacks of a kernel make of sensor readings, between the world's sensors and the engines.

Each sensor fault alters a copy of its vehicles' rows, in order of attack and name. What an attack that acts has written
is kept and passed on, to later sensor faults and to the engines. An engine none of whose vehicles is altered gets the
world's own arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

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
        owned.sort(key=lambda pair: (pair[0].id, pair[1].name))
        vehicles = list(world.vehicles) if world is not None else []
        check_faults("sensor fault", owned, vehicles)
        altered = sorted({vehicles.index(vehicle) for _, fault in owned for vehicle in fault.vehicles})
        self.present = bool(owned)
        """Whether there are any."""
        self._rows = np.array(altered, dtype=np.int64)
        self._place = np.full(len(vehicles), -1, dtype=np.int64)
        self._place[self._rows] = np.arange(len(altered))
        self._owned = [
            (attack, fault, self._place[np.array([vehicles.index(v) for v in fault.vehicles], dtype=np.int64)])
            for attack, fault in owned
        ]
        self._acts = ActCounter("sensor fault")
        self._readings: Sensors | None = None

    def apply(self, now: Time, world: World) -> list[tuple[AttackState, SensorFault, FrameId]]:
        """Apply every sensor fault to this tick's readings; returns each act that takes effect, with its own id."""
        table = _copy(world.sensors(self._rows))
        found = []
        for attack, fault, places in self._owned:
            rows = Sensors(*(getattr(table, name)[places] for name in _ARRAYS))
            try:
                done = list(fault.on_sensors(now, rows))
            except Exception as error:
                raise attribute_error(f"sensor fault {fault.name}", now, error) from error
            if takes_effect(attack, now):
                for name in _ARRAYS:
                    getattr(table, name)[places] = getattr(rows, name)
                found += [(attack, fault, self._acts.number(fault, *act)) for act in done]
        self._readings = table
        return found

    def alter(self, rows: Rows, sensors: Sensors) -> Sensors:
        """An engine's sensor readings with what the sensor faults have made of them; `rows` are its world rows."""
        places = self._place[rows]
        hit = np.flatnonzero(places >= 0)
        if not len(hit):
            return sensors
        assert self._readings is not None
        sensors = _copy(sensors)
        for name in _ARRAYS:
            array = getattr(sensors, name)
            array[hit] = getattr(self._readings, name)[places[hit]]
            array.flags.writeable = False
        return sensors


def _copy(sensors: Sensors) -> Sensors:
    return Sensors(*(np.array(getattr(sensors, name)) for name in _ARRAYS))
