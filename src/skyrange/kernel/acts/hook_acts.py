"""Sensor faults and body faults of a kernel: their validation, and the ids of their acts."""

from __future__ import annotations

from collections.abc import Sequence

from skyrange.contracts.components import BodyHook, SensorHook
from skyrange.core.errors import ComponentError, InputError, Problem, nearest
from skyrange.core.ids import FrameId
from skyrange.kernel.acts.act_states import ActState


class ActCounter:
    """Ids of the acts of faults of one sort."""

    def __init__(self, sort: str) -> None:
        """`sort` is what error messages call such a fault."""
        self._sort = sort
        self._counts: dict[tuple[str, str], int] = {}

    def number(self, fault: SensorHook | BodyHook, vehicle: str, part: str) -> FrameId:
        """The id of the next act of `fault` on a part of a vehicle. Raises `ComponentError` for another's vehicle."""
        if vehicle not in fault.vehicles:
            raise ComponentError(f"{self._sort} {fault.name}", f"reports an act on {vehicle}, which is not its own")
        link = f"{part}:{vehicle}"
        serial = self._counts.get((fault.name, link), 0)
        self._counts[fault.name, link] = serial + 1
        return FrameId(link, "fwd", fault.name, serial)


def check_faults(sort: str, owned: Sequence[tuple[ActState, SensorHook | BodyHook]], vehicles: Sequence[str]) -> None:
    """Raise `InputError` for a name used twice, a vehicle named twice, or one that is not in `vehicles`."""
    problems = []
    seen: set[str] = set()
    for attack, fault in owned:
        if fault.name in seen:
            problems.append(Problem(f"{attack.id}.faults", repr(fault.name), f"a name that no other {sort} has"))
        seen.add(fault.name)
        problems += [
            Problem(f"{attack.id}.{fault.name}.vehicles", repr(vehicle), "a vehicle", nearest(vehicle, vehicles))
            for vehicle in fault.vehicles
            if vehicle not in vehicles
        ]
        if len(set(fault.vehicles)) < len(fault.vehicles):
            repeated = repr(list(fault.vehicles))
            problems.append(Problem(f"{attack.id}.{fault.name}.vehicles", repeated, "each vehicle once"))
    if problems:
        raise InputError("wiring", problems)
