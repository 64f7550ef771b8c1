"""Control handover between mission and avoidance: what a companion commands, and when it does not interfere.

It acts in AUTO, by switching the aircraft to GUIDED, and returns it to AUTO. It knows the mode from HEARTBEATs alone,
up to a second late; so a command has some time to take effect, and is repeated a few times. Any other mode (an
operator's choice, LAND, RTL, a failsafe), and AUTO again after GUIDED was confirmed, means that somebody else has
taken control: the companion yields at once, commands nothing, and waits before it acts again.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from skyrange.core import elementary_python
from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.vehicle.avoidance.contract import AvoidanceAction, AvoidanceDecision, Episode, Vector
from skyrange.vehicle.companion.autopilot_commands import AUTO, GUIDED, RTL

CONFIRM_NS: Final[Time] = 5 * NS_PER_S // 2
"""A commanded mode appears in a heartbeat within this time: two heartbeats, and their transmission."""
MAX_TRIES: Final = 3
YIELD_NS: Final[Time] = 10 * NS_PER_S
"""How long it stays passive after somebody else took control."""
SAME_WAYPOINT_M: Final = 0.5
"""Waypoints closer to each other than this are the same."""
REPEAT_NS: Final[Time] = 3 * NS_PER_S
"""A waypoint is sent again after this time, because it is not acknowledged and may be lost."""


class ControlState(StrEnum):
    """Who controls the aircraft."""

    MISSION = "mission"
    TAKING_OVER = "taking"
    """GUIDED was commanded and is not confirmed yet."""
    COMPANION = "ours"
    RETURNING = "giving"
    """AUTO was commanded and is not confirmed yet."""


@dataclass(slots=True)
class CompanionCommand:
    """What to send: a mode, a position, a stop; and the note to write."""

    mode: int | None = None
    place: Vector | None = None
    stop: bool = False
    note: str = ""


@dataclass(slots=True)
class ControlHandover:
    """State of one aircraft's avoidance as its companion carries it out."""

    control: ControlState = ControlState.MISSION
    episode: Episode | None = None
    goal_enu_m: Vector | None = None
    """The mission's goal when it was left."""
    left_ns: Time = -NEVER
    """When control was returned."""
    asked_ns: Time = -NEVER
    tries: int = 0
    last_command: tuple[AvoidanceAction, Vector | None] | None = None
    last_command_ns: Time = -NEVER
    quiet_until_ns: Time = -NEVER
    causes: tuple[FrameId, ...] = ()
    """The frames that caused the last command."""

    @property
    def engaged(self) -> bool:
        """Whether the aircraft is out of its mission, or changing from or to it."""
        return self.control is not ControlState.MISSION

    def observe(
        self, now: Time, mode: int, heartbeat_ns: Time, *, flying: bool, failsafe: bool
    ) -> CompanionCommand | None:
        """Take in the state in the heartbeat of `heartbeat_ns`; returns what has to be done about it."""
        if not self.engaged:
            return None
        if not flying:
            return self._yield(now, "decision.avoid_ended")
        fresh = heartbeat_ns > self.asked_ns
        if mode not in (AUTO, GUIDED):
            return self._yield(now, "decision.yield") if fresh or self.control is ControlState.COMPANION else None
        if self.control is ControlState.COMPANION and (mode == AUTO or failsafe):
            command = self._yield(now, "decision.yield")
            command.mode = AUTO if failsafe and mode == GUIDED else None  # left in GUIDED it would hover there
            return command
        wanted = AUTO if self.control is ControlState.RETURNING else GUIDED
        if self.control is not ControlState.COMPANION and mode == wanted and fresh:
            self.control = ControlState.MISSION if wanted == AUTO else ControlState.COMPANION
            return None
        if self.control is not ControlState.COMPANION and now - self.asked_ns >= CONFIRM_NS:
            if self.tries >= MAX_TRIES:
                return self._yield(now, "decision.avoid_refused")
            self.asked_ns, self.tries, self.last_command = now, self.tries + 1, None
            return CompanionCommand(wanted)
        return None

    def follow(self, now: Time, decision: AvoidanceDecision, goal_enu_m: Vector) -> CompanionCommand | None:
        """Carry out a decision: what to send, None if there is nothing new."""
        self.episode = decision.episode
        action = decision.action
        if action is AvoidanceAction.KEEP:
            return None
        if action in (AvoidanceAction.RESUME, AvoidanceAction.RETURN):
            self.control, self.asked_ns, self.tries, self.last_command = ControlState.RETURNING, now, 1, None
            self.left_ns = now
            if action is AvoidanceAction.RESUME:
                return CompanionCommand(AUTO, note="decision.resume")
            self.control, self.quiet_until_ns = ControlState.MISSION, now + YIELD_NS
            return CompanionCommand(RTL, note="decision.avoid_return")
        command = CompanionCommand()
        if self.control in (ControlState.MISSION, ControlState.RETURNING):
            self.control, self.asked_ns, self.tries, self.last_command = ControlState.TAKING_OVER, now, 1, None
            self.goal_enu_m = goal_enu_m
            command.mode, command.note = GUIDED, "decision.avoid"
        wanted = (action, decision.waypoint_enu_m)
        same = (
            self.last_command is not None
            and self.last_command[0] is action
            and _same_waypoint(self.last_command[1], wanted[1])
        )
        if same and now - self.last_command_ns < REPEAT_NS:
            return None
        if not same:
            command.note = "decision.avoid"
        command.place, command.stop = decision.waypoint_enu_m, action is AvoidanceAction.STOP
        self.last_command, self.last_command_ns = wanted, now
        return command

    def _yield(self, now: Time, note: str) -> CompanionCommand:
        self.control, self.episode, self.last_command = ControlState.MISSION, None, None
        self.left_ns, self.quiet_until_ns = now, now + YIELD_NS
        return CompanionCommand(note=note)


def _same_waypoint(first: Vector | None, second: Vector | None) -> bool:
    """Whether two waypoints are the same to the autopilot."""
    return (
        first == second
        if first is None or second is None
        else elementary_python.distance(first, second) < SAME_WAYPOINT_M
    )
