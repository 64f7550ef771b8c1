"""Geometric avoidance: a safe waypoint, then on with the mission. The published behaviour.

A track on a conflict course yields a waypoint at once: the first bend of the shortest way to the goal that keeps clear
of walls and of everybody heard. Passing on the right is preferred, so that two who meet head-on and do alike
pass each other (as 14 CFR 91.113(e) has it, for aircraft with people on board).
"""

from __future__ import annotations

import math

from skyrange.core.time import Time
from skyrange.vehicle.avoidance.conflicts import find_conflicts, velocity_towards
from skyrange.vehicle.avoidance.contract import AvoidanceLimits, AvoidancePlugin, Episode, Own, Tracks, Vector
from skyrange.vehicle.avoidance.episodes import EpisodicAvoidance
from skyrange.vehicle.avoidance.path_search import find_first_waypoint
from skyrange.vehicle.avoidance.wall_queries import is_straight_clear


class Geometric(EpisodicAvoidance):
    """`geometric`."""

    kind = "geometric"

    def needed(self, own: Own, tracks: Tracks) -> bool:
        """Not where the way straight to the goal is open: what conflicts then is a turn that is being flown."""
        place, direct = find_first_waypoint(
            own, own.pos_enu_m, tracks, self.walls, self.limits, self.limits.protected_m
        )
        return place is None or not direct

    def find_waypoint(self, now: Time, own: Own, tracks: Tracks, episode: Episode, radius_m: float) -> Vector | None:
        """The first place on the shortest way that is open."""
        return find_first_waypoint(own, episode.anchor_enu_m, tracks, self.walls, self.limits, radius_m)[0]

    def still_good(self, own: Own, tracks: Tracks, episode: Episode) -> bool:
        """Not reached, and nobody and nothing in between."""
        place = episode.waypoint_enu_m
        if place is None or math.dist(place, own.pos_enu_m) <= self.limits.arrive_m or episode.stuck_ns is not None:
            return False
        velocity, takes_s = velocity_towards(own.pos_enu_m, place, own.cruise_mps)
        within_s = min(takes_s, self.limits.look_ahead_s)
        found = find_conflicts(own.pos_enu_m, velocity, tracks, self.limits, 1.0, within_s, within_s)
        return not found and is_straight_clear(self.walls, own.pos_enu_m, place, self.limits.wall_m)


GEOMETRIC = AvoidancePlugin(
    AvoidanceLimits,
    lambda limits, context: Geometric(context.city, limits),
    "Flies the shortest way to its goal that keeps clear of other aircraft and of walls.",
)
