"""Separation of aircraft on different cores: no core sees those of another, so none may come near enough to touch.

In a time T an aircraft of speed v moves at most (v + a·T)·T, with a no less than any acceleration that an airframe can
have. Two aircraft that are farther apart than both can move until the next check cannot collide before it. Where they
were is known up to a barrier later, so T is the time between two barriers and this delay. All cores decide this from
the same numbers, so all decide alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S, Time
from skyrange.world.airframes import Airframe
from skyrange.world.collision.broad_phase import (
    HEIGHT,
    NEAR_M,
    RADIUS,
    Floats,
    Ints,
    cylinder_gap,
    list_near_pairs,
    shape_row,
)


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


ACCELERATION_MPS2: Final = 200.0
"""More than thrust, gravity and drag in a wind of 60 m/s together give any of the airframes."""
TUMBLING_MPS: Final = 10.0
"""How much faster than its centre of gravity the gear of a tumbling aircraft moves: a lever of 0.3 m at 30 rad/s."""


class Approach(NamedTuple):
    """Two aircraft on different cores that may touch before the next check, and the gap between them."""

    vehicle: str
    other: str
    gap_m: float


@compiled
def _speed_of(velocity: Floats) -> float:
    """How fast any part of an aircraft moves."""
    return math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2) + TUMBLING_MPS


@compiled
def _find_fastest(velocity: Floats) -> float:
    """The highest speed, or NaN if one is."""
    fastest = 0.0
    for i in range(velocity.shape[0]):
        speed = _speed_of(velocity[i])
        if not speed <= fastest:
            fastest = speed
    return fastest


@compiled
def _reach_m(speed: float, horizon_s: float) -> float:
    """How far an aircraft moves at most."""
    return (speed + ACCELERATION_MPS2 * horizon_s) * horizon_s


@compiled
def _find_close(
    pairs: Ints, position: Floats, velocity: Floats, horizon_s: float, shape: Floats, airframe: Ints
) -> tuple[int, float]:
    """The first pair with a gap smaller than both can move, -1 if there is none, and its gap."""
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        a, b = shape[airframe[i]], shape[airframe[j]]
        gap = cylinder_gap(position[i], position[j], a[RADIUS] + b[RADIUS], a[HEIGHT], b[HEIGHT])
        reach = _reach_m(_speed_of(velocity[i]), horizon_s) + _reach_m(_speed_of(velocity[j]), horizon_s)
        if not gap > reach:
            return k, gap
    return -1, 0.0


class Separation:
    """Watches the gaps between aircraft on different cores, barrier by barrier."""

    def __init__(self, motion: FleetMotion, airframes: Sequence[Airframe], period_ns: Time, horizon_ns: Time) -> None:
        """`airframes` in the order of `motion.vehicles`. `period_ns` is the longest time between what two checks see;
        `horizon_ns` the longest from what a check sees to the next check.
        """
        kinds = {airframe.name: airframe for airframe in airframes}
        names = sorted(kinds)
        self._motion = motion
        self._shape = np.array([shape_row(kinds[name]) for name in names])
        self._airframe = np.array([names.index(airframe.name) for airframe in airframes], dtype=np.int64)
        vehicles = motion.vehicles
        self._order = np.array(sorted(range(len(vehicles)), key=vehicles.__getitem__), dtype=np.int64)
        self._period_s = period_ns / NS_PER_S
        self._horizon_s = horizon_ns / NS_PER_S
        self._pairs = np.empty((0, 2), dtype=np.int64)
        self._listed_m = 0.0
        """How far any aircraft may have moved since the near pairs were listed."""
        self._census_due = True

    def check(self) -> Approach | None:
        """Two aircraft that may touch before the next check; `None` if there are none."""
        position, velocity = self._motion.motion()
        fastest = _find_fastest(velocity)
        # a pair that is not listed is at least NEAR_M apart, less what both have moved since, and will before the next
        if self._census_due or not 2.0 * (self._listed_m + _reach_m(fastest, self._horizon_s)) < NEAR_M:
            self._census_due, self._listed_m = False, 0.0
            pairs, _ = list_near_pairs(self._order, self._shape, self._airframe, position, 0.0)
            self._pairs = pairs[self._motion.core[pairs[:, 0]] != self._motion.core[pairs[:, 1]]]
        self._listed_m += _reach_m(fastest, self._period_s)
        if not len(self._pairs):
            return None
        at, gap = _find_close(self._pairs, position, velocity, self._horizon_s, self._shape, self._airframe)
        if at < 0:
            return None
        a, b = self._pairs[at].tolist()
        return Approach(self._motion.vehicles[a], self._motion.vehicles[b], gap)
