"""What if an aircraft listens and does nothing? The mission is flown, whoever is in the way."""

from __future__ import annotations

from typing import Any

from skyrange.city.city import City
from skyrange.core.time import Time
from skyrange.vehicle.avoidance.contract import KEEP, Decision, Episode, Own, Tracks, limits_of


class NoAvoidance:
    """`none`."""

    kind = "none"

    def __init__(self, city: City | None = None, **settings: Any) -> None:
        """Takes what the others take. Raises `InputError`."""
        self.limits = limits_of(self.kind, settings)

    def decide(self, now: Time, own: Own, tracks: Tracks, episode: Episode | None) -> Decision:
        """KEEP, always."""
        return KEEP
