"""Engine of the honest arm: it flies real bodies on the tracks that attacks claim, while these attacks act.

A claimed track has a constant velocity, so the poses that it imposes are exact: at every tick from the start of the
attack the body is where a broadcast of that time says. A body does not exist before the start nor after the stop: it is
in no truth, and this engine keeps it far above all others. Nothing of it depends on what happens in the range.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from skyrange.contracts.claims import ClaimedTrack
from skyrange.contracts.components import EngineBase, Finished, Poses, Sensors, Source
from skyrange.contracts.links import Schedule
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core import elementwise
from skyrange.core.elementary import atan2
from skyrange.core.ids import Port, qualify
from skyrange.core.time import NS_PER_S, Time
from skyrange.world.airframes import MOTORS

NAME: Final = "honest"
PARKED_M: Final = 20_000.0
"""Height of the first body of a run that does not exist; the next one is `SPACING_M` higher."""
SPACING_M: Final = 100.0


@dataclass(frozen=True, slots=True)
class HonestBody:
    """A real aircraft on a claimed track."""

    vehicle: str
    """Its id in truth, which is that of its radio in the medium."""
    track: ClaimedTrack
    schedule: Schedule
    """When its attack acts."""
    parked_m: float = PARKED_M
    """Its height while it does not exist."""
    run: int = 0
    """The number of its run in a batch."""


class ClaimedTracks(EngineBase):
    """An engine (contract: `contracts.components.Engine`) that imposes poses. It has no ports and runs no autopilot."""

    name = NAME
    ports: Sequence[Port] = ()
    clock: Literal["lockstep", "wall"] = "lockstep"
    repeatable: Literal["bytes", "outcome"] = "bytes"
    preroll_ns: Time = 0
    source = Source.KINEMATIC

    def __init__(self, bodies: Sequence[HonestBody], quantum_ns: Time) -> None:
        """`quantum_ns` is the world's: a body appears in the tick in which its attack starts, if that is known."""
        self.vehicles: Sequence[str] = [qualify(body.run, body.vehicle) for body in bodies]
        self.moves: Sequence[str] = self.vehicles
        self.service_ns: Time = quantum_ns
        self._bodies = bodies
        n = len(bodies)
        self._motors = np.zeros((n, MOTORS))
        self._present = np.zeros(n, dtype=np.bool_)
        velocity = np.array([body.track.velocity_mps for body in bodies], dtype=np.float64).reshape(n, 3)
        half_yaw = np.array([0.5 * atan2(north, east) for east, north, _ in velocity.tolist()])
        self._velocity = velocity
        self._attitude = np.column_stack(
            [elementwise.cos(half_yaw), np.zeros(n), np.zeros(n), elementwise.sin(half_yaw)]
        )

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """It senses nothing."""

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Impose the poses of the bodies that exist; the world takes each to where it is one tick later."""
        n = len(self._bodies)
        soon = tick + self.service_ns
        exists = np.array([body.schedule.start_ns <= soon < body.schedule.stop_ns for body in self._bodies])
        changed = exists != self._present
        if not exists.any() and not changed.any():
            return Finished(self._motors, Outbox())
        position = np.empty((n, 3))
        for row, body in enumerate(self._bodies):
            if exists[row]:
                position[row] = body.track.at((tick - body.schedule.start_ns) / NS_PER_S)
            else:
                position[row] = *body.track.start_enu_m[:2], body.parked_m
        self._present = exists
        velocity = np.where(exists[:, None], self._velocity, 0.0)
        poses = Poses(exists | changed, position, velocity, self._attitude, np.zeros((n, 3)), exists)
        return Finished(self._motors, Outbox(), poses=poses)
