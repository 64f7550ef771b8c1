"""No avoidance: the aircraft flies its mission and ignores other aircraft."""

from __future__ import annotations

from skyrange.city.city import City
from skyrange.core.time import Time
from skyrange.vehicle.avoidance.contract import (
    KEEP,
    AvoidanceDecision,
    AvoidanceLimits,
    AvoidancePlugin,
    Episode,
    Own,
    Tracks,
)


class NoAvoidance:
    """`none`."""

    kind = "none"

    def __init__(self, city: City | None = None, limits: AvoidanceLimits | None = None) -> None:
        """Takes the arguments of the other kinds."""
        self.limits = limits or AvoidanceLimits()

    def decide(self, now: Time, own: Own, tracks: Tracks, episode: Episode | None) -> AvoidanceDecision:
        """Always KEEP."""
        return KEEP


NONE = AvoidancePlugin(
    AvoidanceLimits,
    lambda limits, context: NoAvoidance(context.city, limits),
    "Flies the mission and ignores other aircraft.",
)
