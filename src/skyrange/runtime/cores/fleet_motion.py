"""Positions and velocities of the aircraft on all cores, as exchanged last."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skyrange.contracts.components import Floats


class FleetMotion:
    """What is known of all aircraft: `vehicles` core by core, and their motion in that order."""

    def __init__(self, vehicles: Sequence[Sequence[str]]) -> None:
        """`vehicles` are those of each core, in the order of its world."""
        self.vehicles: Sequence[str] = tuple(vehicle for part in vehicles for vehicle in part)
        self.core = np.repeat(np.arange(len(vehicles)), [len(part) for part in vehicles])
        """(n,): the core of each aircraft."""
        self._sizes = [len(part) for part in vehicles]
        self._position = np.zeros((len(self.vehicles), 3))
        self._velocity = np.zeros((len(self.vehicles), 3))

    @staticmethod
    def pack(position: Floats, velocity: Floats) -> bytes:
        """The motion of one core's aircraft, (n, 3) each, as bytes."""
        return np.hstack((position, velocity)).tobytes()

    def update(self, parts: Sequence[bytes]) -> None:
        """Take over what `pack` packed on each core."""
        rows = np.concatenate(
            [np.frombuffer(part).reshape(size, 6) for part, size in zip(parts, self._sizes, strict=True)]
        )
        self._position, self._velocity = np.ascontiguousarray(rows[:, :3]), np.ascontiguousarray(rows[:, 3:])

    def motion(self) -> tuple[Floats, Floats]:
        """Position of the gear and velocity, (n, 3) each."""
        return self._position, self._velocity
