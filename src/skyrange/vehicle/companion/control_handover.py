"""Control handover between mission and avoidance: what a companion commands, and when it does not interfere.

It acts in AUTO, by switching the aircraft to GUIDED, and returns it to AUTO. It knows the mode from HEARTBEATs alone,
up to a second late; so a command has some time to take effect, and is repeated a few times. Any other mode (an
operator's choice, LAND, RTL, a failsafe), and AUTO again after GUIDED was confirmed, means that somebody else has
taken control: the companion yields at once, commands nothing, and waits before it acts again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.vehicle.avoidance.contract import Action, Decision, Episode, Vector
from skyrange.vehicle.companion.wire import AUTO, GUIDED, RTL

SHOWN_NS: Final[Time] = 5 * NS_PER_S // 2
"""A commanded mode appears in a heartbeat within this time: two heartbeats, and their transmission."""
TRIES: Final = 3
YIELD_NS: Final[Time] = 10 * NS_PER_S
"""How long it stays passive after somebody else took control."""
SAME_M: Final = 0.5
"""Waypoints closer to each other than this are the same."""
TELL_NS: Final[Time] = 3 * NS_PER_S
"""A waypoint is sent again after this time, because it is not acknowledged and may be lost."""


class Hold(StrEnum):
    """Who controls the aircraft."""

    MISSION = "mission"
    TAKING = "taking"
    """GUIDED was commanded and is not confirmed yet."""
    OURS = "ours"
    GIVING = "giving"
    """AUTO was commanded and is not confirmed yet."""


@dataclass(slots=True)
class Order:
    """What to send: a mode, a position, a stop; and the note to write."""

    mode: int | None = None
    place: Vector | None = None
    stop: bool = False
    note: str = ""


@dataclass(slots=True)
class Guard:
    """State of one aircraft's avoidance as its companion carries it out."""

    hold: Hold = Hold.MISSION
    episode: Episode | None = None
    goal_enu_m: Vector | None = None
    """The mission's goal when it was left."""
    left_ns: Time = -NEVER
    """When control was returned."""
    asked_ns: Time = -NEVER
    tries: int = 0
    told: tuple[Action, Vector | None] | None = None
    told_ns: Time = -NEVER
    quiet_until_ns: Time = -NEVER
    causes: tuple[FrameId, ...] = ()
    """The frames that caused the last command."""

    @property
    def engaged(self) -> bool:
        """Whether the aircraft is out of its mission, or changing from or to it."""
        return self.hold is not Hold.MISSION

    def observe(self, now: Time, mode: int, beat_ns: Time, flying: bool, failsafe: bool) -> Order | None:
        """Take in the state in the heartbeat of `beat_ns`; returns what has to be done about it."""
        if not self.engaged:
            return None
        if not flying:
            return self._yield(now, "decision.avoid_ended")
        fresh = beat_ns > self.asked_ns
        if mode not in (AUTO, GUIDED):
            return self._yield(now, "decision.yield") if fresh or self.hold is Hold.OURS else None
        if self.hold is Hold.OURS and (mode == AUTO or failsafe):
            order = self._yield(now, "decision.yield")
            order.mode = AUTO if failsafe and mode == GUIDED else None  # left in GUIDED it would hover there
            return order
        wanted = AUTO if self.hold is Hold.GIVING else GUIDED
        if self.hold is not Hold.OURS and mode == wanted and fresh:
            self.hold = Hold.MISSION if wanted == AUTO else Hold.OURS
            return None
        if self.hold is not Hold.OURS and now - self.asked_ns >= SHOWN_NS:
            if self.tries >= TRIES:
                return self._yield(now, "decision.avoid_refused")
            self.asked_ns, self.tries, self.told = now, self.tries + 1, None
            return Order(wanted)
        return None

    def follow(self, now: Time, decision: Decision, goal_enu_m: Vector) -> Order | None:
        """Carry out a decision: what to send, None if there is nothing new."""
        self.episode = decision.episode
        action = decision.action
        if action is Action.KEEP:
            return None
        if action in (Action.RESUME, Action.RETURN):
            self.hold, self.asked_ns, self.tries, self.told = Hold.GIVING, now, 1, None
            self.left_ns = now
            if action is Action.RESUME:
                return Order(AUTO, note="decision.resume")
            self.hold, self.quiet_until_ns = Hold.MISSION, now + YIELD_NS
            return Order(RTL, note="decision.avoid_return")
        order = Order()
        if self.hold in (Hold.MISSION, Hold.GIVING):
            self.hold, self.asked_ns, self.tries, self.told = Hold.TAKING, now, 1, None
            self.goal_enu_m = goal_enu_m
            order.mode, order.note = GUIDED, "decision.avoid"
        wanted = (action, decision.waypoint_enu_m)
        same = self.told is not None and self.told[0] is action and _same_waypoint(self.told[1], wanted[1])
        if same and now - self.told_ns < TELL_NS:
            return None
        if not same:
            order.note = "decision.avoid"
        order.place, order.stop = decision.waypoint_enu_m, action is Action.STOP
        self.told, self.told_ns = wanted, now
        return order

    def _yield(self, now: Time, note: str) -> Order:
        self.hold, self.episode, self.told = Hold.MISSION, None, None
        self.left_ns, self.quiet_until_ns = now, now + YIELD_NS
        return Order(note=note)


def _same_waypoint(one: Vector | None, two: Vector | None) -> bool:
    """Whether two waypoints are the same to the autopilot."""
    return one == two if one is None or two is None else math.dist(one, two) < SAME_M
