"""Avoidance by stopping: the aircraft holds until the way is clear, and at last returns home.

Two that stop for each other wait until one of them gives up: stopping alone resolves no head-on encounter.
"""

from __future__ import annotations

from skyrange.core.time import Time
from skyrange.vehicle.avoidance.contract import AvoidanceLimits, AvoidancePlugin, Episode, Own, Tracks, Vector
from skyrange.vehicle.avoidance.episodes import EpisodicAvoidance


class Stop(EpisodicAvoidance):
    """`stop`."""

    kind = "stop"

    def find_waypoint(self, now: Time, own: Own, tracks: Tracks, episode: Episode, radius_m: float) -> Vector | None:
        """Nowhere."""
        return None


STOP = AvoidancePlugin(
    AvoidanceLimits,
    lambda limits, context: Stop(context.city, limits),
    "Holds until the way is clear, and returns home at last.",
)
