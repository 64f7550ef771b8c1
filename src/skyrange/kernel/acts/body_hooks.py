"""Body faults: what the benign faults of a kernel make of the motors of aircraft and of the air around them.

At each tick every body fault that acts is asked what it makes of its vehicles from there to the next tick. What they
have written is combined, products of thrust and sums of wind, and handed to the world. The world is not touched before
one acts, and is told once when the last has ended.
"""

from __future__ import annotations

from collections.abc import Container, Sequence

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import BodyHook, Disturbances, World
from skyrange.core.errors import InputError, Problem, attribute_error
from skyrange.core.ids import FrameId
from skyrange.core.time import Time
from skyrange.kernel.acts.act_states import ActCounter, ActState, check_faults, takes_effect


class BodyHookInjector:
    """The body faults of one kernel."""

    def __init__(self, attacks: Sequence[ActState], world: World | None, imposed: Container[str]) -> None:
        """`imposed` are the vehicles whose poses an engine imposes.

        Raises `InputError` for a body fault of an attack, a name used twice, or a vehicle that the world does not have
        or does not move.
        """
        owned = [(attack, fault) for attack in attacks for fault in attack.plan.body_hooks]
        owned.sort(key=lambda pair: (pair[0].id, pair[1].name))
        vehicles = list(world.vehicles) if world is not None else []
        check_faults("body fault", owned, vehicles)
        _check_bodies(owned, imposed)
        altered = sorted({vehicles.index(vehicle) for _, fault in owned for vehicle in fault.vehicles})
        self.present = bool(owned)
        """Whether there are any."""
        self._rows = np.array(altered, dtype=np.int64)
        self._places = _run_of(altered)
        self._owned = [
            (attack, fault, _run_of([altered.index(vehicles.index(v)) for v in fault.vehicles]))
            for attack, fault in owned
        ]
        self._acts = ActCounter("body fault")
        self._told = b""
        """What the world was last told; empty while it is undisturbed."""
        self._bodies: list[Disturbances] = []
        """Of all altered vehicles, then of those of each body fault: filled anew at each tick."""

    def is_idle(self, now: Time) -> bool:
        """Whether none acts at `now`, and the world is undisturbed."""
        return not self._told and not any(takes_effect(attack, now) for attack, _, _ in self._owned)

    def apply(self, now: Time, world: World) -> list[tuple[ActState, BodyHook, FrameId]]:
        """Ask every body fault that acts, and disturb the world by what they write; returns each act with its own
        id.
        """
        if self.is_idle(now):
            return []
        position, _ = world.motion()
        if not self._bodies:
            motors = world.sensors(self._rows).rotor_radps.shape[1]
            counts = [len(self._rows), *(len(fault.vehicles) for _, fault, _ in self._owned)]
            self._bodies = [_undisturbed(count, motors) for count in counts]
        total = self._bodies[0]
        _calm(total, position, self._places)
        acting = False
        numbered_acts = []
        for (attack, fault, places), bodies in zip(self._owned, self._bodies[1:], strict=True):
            if not takes_effect(attack, now):
                continue
            acting = True
            _calm(bodies, total.position_enu_m, places)
            try:
                done = list(fault.on_bodies(now, bodies))
            except Exception as error:
                raise attribute_error(f"body fault {fault.name}", now, error) from error
            total.thrust_share[places] *= bodies.thrust_share
            total.wind_enu_mps[places] += bodies.wind_enu_mps
            numbered_acts += [(attack, fault, self._acts.number(fault, *act)) for act in done]
        total_bytes = total.thrust_share.tobytes() + total.wind_enu_mps.tobytes() if acting else b""
        if total_bytes != self._told:
            world.disturb(self._rows, total.thrust_share, total.wind_enu_mps)
        self._told = total_bytes
        return numbered_acts


def _undisturbed(count: int, motors: int) -> Disturbances:
    return Disturbances(np.zeros((count, 3)), np.ones((count, motors)), np.zeros((count, 3)))


def _calm(bodies: Disturbances, position: NDArray[np.float64], places: slice | NDArray[np.int64]) -> None:
    """Set the positions to those of some rows, and undo every disturbance."""
    bodies.position_enu_m[:] = position[places]
    bodies.thrust_share.fill(1.0)
    bodies.wind_enu_mps.fill(0.0)


def _run_of(places: list[int]) -> slice | NDArray[np.int64]:
    """Places as a slice if they follow each other, because numpy reads and writes slices faster."""
    if places and places == list(range(places[0], places[0] + len(places))):
        return slice(places[0], places[-1] + 1)
    return np.array(places, dtype=np.int64)


def _check_bodies(owned: Sequence[tuple[ActState, BodyHook]], imposed: Container[str]) -> None:
    problems = [
        Problem(f"{attack.id}.body_hooks", repr(fault.name), "none: only a benign fault acts on bodies")
        for attack, fault in owned
        if not attack.plan.is_fault
    ]
    problems += [
        Problem(f"{attack.id}.{fault.name}.vehicles", repr(vehicle), "an aircraft that the world moves")
        for attack, fault in owned
        for vehicle in fault.vehicles
        if vehicle in imposed
    ]
    if problems:
        raise InputError("wiring", problems)
