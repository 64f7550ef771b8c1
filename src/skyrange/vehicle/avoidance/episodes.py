"""Episodes of avoidance: when one begins, when it is over, how long it may last. The same for every kind.

A kind says where to go; this says when. It begins with a conflict. The mission is resumed once the straight way to the
goal has been clear of walls and, by a margin, of others for a while: entering and leaving have different
thresholds, so that it does not chatter. With no way at all the aircraft holds, after a while accepts a smaller
distance, and in the end goes home: it does not wait for ever.

Who was climbing or descending over one place comes back there first. A take-off or a landing that is resumed goes
straight up or down from wherever it is, and a mission flies on from there: over what nobody has looked at.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Final

from skyrange.city.city import City
from skyrange.core import elementary
from skyrange.core.time import Time, from_seconds
from skyrange.vehicle.avoidance.conflicts import find_conflicts, velocity_towards
from skyrange.vehicle.avoidance.contract import (
    KEEP,
    AvoidanceAction,
    AvoidanceDecision,
    AvoidanceLimits,
    Episode,
    Own,
    Tracks,
    Vector,
)
from skyrange.vehicle.avoidance.wall_queries import is_straight_clear, walls_of

UPRIGHT_M: Final = 3.0
"""A goal within this of a place seen from above is over it, or under it."""


class EpisodicAvoidance(ABC):
    """A kind of avoidance but for the way it takes."""

    kind = ""

    def __init__(self, city: City | None = None, limits: AvoidanceLimits | None = None) -> None:
        """Without a city the country is open."""
        self.limits = limits or AvoidanceLimits()
        self.walls = walls_of(city)

    @abstractmethod
    def find_waypoint(self, now: Time, own: Own, tracks: Tracks, episode: Episode, radius_m: float) -> Vector | None:
        """Where to fly now; None for nowhere: hold."""

    def needed(self, own: Own, tracks: Tracks) -> bool:
        """Whether a conflict calls for anything but flying on."""
        return True

    def decide(self, now: Time, own: Own, tracks: Tracks, episode: Episode | None) -> AvoidanceDecision:
        """See `contract.Avoidance`."""
        limits = self.limits
        if episode is None:
            rows = find_conflicts(own.pos_enu_m, own.vel_enu_mps, tracks, limits)
            if not rows or not self.needed(own, tracks):
                return KEEP
            return self._move(now, own, tracks, Episode(now, own.pos_enu_m), rows)
        rows, open_ = self._resumable(own, tracks)
        east_m, north_m, _ = own.goal_enu_m
        if _beside(episode.anchor_enu_m, own.goal_enu_m) <= UPRIGHT_M < _beside(own.pos_enu_m, own.goal_enu_m):
            own, open_ = own._replace(goal_enu_m=(east_m, north_m, own.pos_enu_m[2])), False
        if not open_:
            episode = replace(episode, clear_ns=None)
        elif episode.clear_ns is None:
            episode = replace(episode, clear_ns=now)
        elif now - episode.clear_ns >= from_seconds(limits.clear_s):
            return AvoidanceDecision(AvoidanceAction.RESUME, None)
        return self._move(now, own, tracks, episode, rows)

    def _resumable(self, own: Own, tracks: Tracks) -> tuple[tuple[int, ...], bool]:
        """Who is in the way of flying straight to the goal, and whether nobody and no wall is."""
        velocity, takes_s = velocity_towards(own.pos_enu_m, own.goal_enu_m, own.cruise_mps)
        limits = self.limits
        ahead_s = limits.look_ahead_s * limits.margin
        rows = find_conflicts(
            own.pos_enu_m,
            velocity,
            tracks,
            limits,
            scale=limits.margin,
            moving_s=min(takes_s, ahead_s),
            standing_s=takes_s,
        )
        return rows, not rows and is_straight_clear(self.walls, own.pos_enu_m, own.goal_enu_m, limits.wall_m)

    def _move(self, now: Time, own: Own, tracks: Tracks, episode: Episode, rows: tuple[int, ...]) -> AvoidanceDecision:
        limits = self.limits
        waited = 0 if episode.stuck_ns is None else now - episode.stuck_ns
        if waited >= from_seconds(limits.give_up_s) or now - episode.begun_ns >= from_seconds(limits.longest_s):
            return AvoidanceDecision(AvoidanceAction.RETURN, None, None, rows)
        keeps = now - episode.changed_ns < from_seconds(limits.commit_s) or self.still_good(own, tracks, episode)
        if keeps:
            action = AvoidanceAction.STOP if episode.waypoint_enu_m is None else AvoidanceAction.GO
            return AvoidanceDecision(action, episode, episode.waypoint_enu_m, rows)
        shrunk = waited >= from_seconds(limits.patience_s)
        radius_m = min(limits.least_m, limits.protected_m) if shrunk else limits.protected_m
        place = self.find_waypoint(now, own, tracks, episode, radius_m)
        if place is None:
            stuck_ns = now if episode.stuck_ns is None else episode.stuck_ns
            episode = replace(episode, waypoint_enu_m=None, changed_ns=now, stuck_ns=stuck_ns)
            return AvoidanceDecision(AvoidanceAction.STOP, episode, None, rows, self._considered(own, tracks, rows))
        # who squeezes by stays as impatient as it was: the wide cylinder would only send it back
        episode = replace(episode, waypoint_enu_m=place, changed_ns=now, stuck_ns=episode.stuck_ns if shrunk else None)
        return AvoidanceDecision(AvoidanceAction.GO, episode, place, rows, self._considered(own, tracks, rows))

    def _considered(self, own: Own, tracks: Tracks, rows: tuple[int, ...]) -> tuple[int, ...]:
        """The rows, beside those in conflict, that are near enough to shape a waypoint."""
        away = tracks.pos_enu_m[:, :2] - own.pos_enu_m[:2]
        near = (away * away).sum(axis=1) <= (self.limits.reach_m * self.limits.reach_m)
        return tuple(row for row in near.nonzero()[0].tolist() if row not in rows)

    def still_good(self, own: Own, tracks: Tracks, episode: Episode) -> bool:
        """Whether the waypoint that was chosen may be flown to still."""
        return False


def _beside(place: Vector, goal: Vector) -> float:
    """How far a place is from a goal seen from above, in metres."""
    return elementary.hypot(place[0] - goal[0], place[1] - goal[1])
