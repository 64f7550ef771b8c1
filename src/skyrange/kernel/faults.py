"""What do the sensors say after the declared faults have been at them?

Between the world's sensors and the engines. Each fault works on a copy of its vehicles' rows, in order of attack and
name; what an attack that acts has written is kept and handed on, to later faults and to the engines. Vehicles that no
fault reaches keep the world's own arrays where no other vehicle of their engine is reached.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from skyrange.agent.contracts import SensorAct, SensorFault, Sensors, World
from skyrange.core.errors import ComponentError, Fault, InputError, attribute_error, nearest
from skyrange.core.ids import FrameId
from skyrange.core.time import Time
from skyrange.kernel.stages import Stage, takes_effect

_ARRAYS = tuple(field.name for field in fields(Sensors))
Rows = slice | NDArray[np.int64]


class FaultBench:
    """The sensor faults of all attacks of one kernel."""

    def __init__(self, attacks: Sequence[Stage], world: World | None) -> None:
        """Raises `InputError` for a vehicle that the world does not have, or a name used twice."""
        owned = [(attack, fault) for attack in attacks for fault in attack.plan.faults]
        owned.sort(key=lambda pair: (pair[0].id, pair[1].name))
        vehicles = list(world.vehicles) if world is not None else []
        _check(owned, vehicles)
        reached = sorted({vehicles.index(vehicle) for _, fault in owned for vehicle in fault.vehicles})
        self.present = bool(owned)
        """Whether there is any."""
        self._rows = np.array(reached, dtype=np.int64)
        self._place = np.full(len(vehicles), -1, dtype=np.int64)
        self._place[self._rows] = np.arange(len(reached))
        self._owned = [
            (attack, fault, self._place[np.array([vehicles.index(v) for v in fault.vehicles], dtype=np.int64)])
            for attack, fault in owned
        ]
        self._acts: dict[tuple[str, str], int] = {}
        self._now: Sensors | None = None

    def work(self, now: Time, world: World) -> list[tuple[Stage, SensorFault, FrameId]]:
        """Apply every fault to this tick's sensors; returns each act that counts, with its own id."""
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
                found += [(attack, fault, self._number(fault, act)) for act in done]
        self._now = table
        return found

    def reaching(self, rows: Rows, sensors: Sensors) -> Sensors:
        """An engine's sensors with what the faults have made of them."""
        places = self._place[rows]
        hit = np.flatnonzero(places >= 0)
        if not len(hit):
            return sensors
        assert self._now is not None
        sensors = _copy(sensors)
        for name in _ARRAYS:
            array = getattr(sensors, name)
            array[hit] = getattr(self._now, name)[places[hit]]
            array.flags.writeable = False
        return sensors

    def _number(self, fault: SensorFault, act: SensorAct) -> FrameId:
        if act.vehicle not in fault.vehicles:
            raise ComponentError(f"sensor fault {fault.name}", f"reports an act on {act.vehicle}, which is not its own")
        link = f"{act.sensor}:{act.vehicle}"
        serial = self._acts.get((fault.name, link), 0)
        self._acts[fault.name, link] = serial + 1
        return FrameId(link, "fwd", fault.name, serial)


def _copy(sensors: Sensors) -> Sensors:
    return Sensors(*(np.array(getattr(sensors, name)) for name in _ARRAYS))


def _check(owned: Sequence[tuple[Stage, SensorFault]], vehicles: Sequence[str]) -> None:
    faults = []
    seen: set[str] = set()
    for attack, fault in owned:
        if fault.name in seen:
            faults.append(Fault(f"{attack.id}.faults", repr(fault.name), "a name that no other sensor fault has"))
        seen.add(fault.name)
        faults += [
            Fault(f"{attack.id}.{fault.name}.vehicles", repr(vehicle), "a vehicle", nearest(vehicle, vehicles))
            for vehicle in fault.vehicles
            if vehicle not in vehicles
        ]
        if len(set(fault.vehicles)) < len(fault.vehicles):
            faults.append(Fault(f"{attack.id}.{fault.name}.vehicles", repr(list(fault.vehicles)), "each vehicle once"))
    if faults:
        raise InputError("wiring", faults)
