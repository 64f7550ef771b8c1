"""Avoidance by stopping: the aircraft holds until the way is clear, and returns home if that takes too long.

Two aircraft that stop for each other wait until one of them gives up: stopping does not resolve a head-on encounter.
"""

from __future__ import annotations

from skyrange.core.time import Time
from skyrange.vehicle.avoidance.contract import AvoidanceLimits, AvoidancePlugin, Episode, Own, Tracks, Vector
from skyrange.vehicle.avoidance.episodes import EpisodicAvoidance


class Stop(EpisodicAvoidance):
    """`stop`."""

    kind = "stop"

    def find_waypoint(self, now: Time, own: Own, tracks: Tracks, episode: Episode, radius_m: float) -> Vector | None:
        """Always None: hold."""
        return None


STOP = AvoidancePlugin(
    AvoidanceLimits,
    lambda limits, context: Stop(context.city, limits),
    "Holds until the way is clear, and returns home if that takes too long.",
)
