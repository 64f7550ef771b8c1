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
        return position.tobytes() + velocity.tobytes()

    def update(self, parts: Sequence[bytes]) -> None:
        """Take over what `pack` packed on each core."""
        begin = 0
        for part, size in zip(parts, self._sizes, strict=True):
            end = begin + size
            self._position[begin:end], self._velocity[begin:end] = np.frombuffer(part).reshape(2, size, 3)
            begin = end

    def motion(self) -> tuple[Floats, Floats]:
        """Position of the gear and velocity, (n, 3) each, which the next update refills."""
        return self._position, self._velocity
