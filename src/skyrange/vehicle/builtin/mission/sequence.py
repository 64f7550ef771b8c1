"""Order of mission commands: the next command from a place on, with jumps followed (AP_Mission.cpp `get_next_cmd`)."""

from __future__ import annotations

from collections.abc import Callable

from skyrange.vehicle.builtin.fleet import MissionItem, Vehicle
from skyrange.vehicle.builtin.mission.command_ids import (
    DO_JUMP_TAG,
    JUMP_TAG,
    JUMPS,
    NAV_COMMANDS,
    NAV_DELAY,
    TAKEOFFS,
)

_MAX_JUMPS = 64  # get_next_cmd
_MAX_PLACES = 16  # is_takeoff_next
MAX_COMMANDS = 255
"""Limit of advance_current_nav_cmd: a loop of jumps and DO commands ends the mission."""


JumpObserver = Callable[[int, int, int], None]
"""Called for each jump made: its item, how often it was made, and how often it may be (-1 unlimited)."""


def next_command(vehicle: Vehicle, seq: int, jumped: JumpObserver | None = None, *, count: bool) -> int | None:
    """Return the first item from `seq` on that is not a jump, following jumps; with `count`, count them as made."""
    made = vehicle.jump_counts if count else dict(vehicle.jump_counts)
    for _ in range(_MAX_JUMPS):
        if seq >= len(vehicle.mission):
            return None
        item = vehicle.mission[seq]
        if item.command not in JUMPS:
            return seq
        target, times = jump_target(vehicle, item), int(item.param2)
        if not 0 < target < len(vehicle.mission):
            return None
        if times < 0 or made.get(seq, 0) < times:
            made[seq] = made.get(seq, 0) + 1
            if jumped is not None:
                jumped(seq, made[seq], times)
            seq = target
        else:
            made.pop(seq, None)
            seq += 1
    return None


def jump_target(vehicle: Vehicle, item: MissionItem) -> int:
    """Return the item that a jump leads to; 0, which is none, for a tag that no item has."""
    return find_tag(vehicle, int(item.param1)) if item.command == DO_JUMP_TAG else int(item.param1)


def find_tag(vehicle: Vehicle, tag: int) -> int:
    """Return the first item that sets a tag, 0 without one (AP_Mission::get_index_of_jump_tag)."""
    tagged = (n for n, item in enumerate(vehicle.mission) if n and item.command == JUMP_TAG and int(item.param1) == tag)
    return next(tagged, 0)


def is_takeoff_next(vehicle: Vehicle, seq: int) -> bool:
    """Whether a take-off is flown from `seq` on, after delays at most (AP_Mission::is_takeoff_next)."""
    for first in range(seq, seq + _MAX_PLACES):
        nav_command = next_nav_command(vehicle, first)
        if nav_command is None or vehicle.mission[nav_command].command != NAV_DELAY:
            return nav_command is not None and vehicle.mission[nav_command].command in TAKEOFFS
    return False


def next_nav_command(vehicle: Vehicle, seq: int) -> int | None:
    """Return the navigation command that ArduPilot expects next from `seq` on, without counting jumps.

    After a DO command that a jump leads to, it looks behind the jump, and so may expect another command than the one
    that is flown: it then stops at a waypoint that it will leave in another direction (AP_Mission::get_next_nav_cmd).
    """
    for first in range(seq, len(vehicle.mission)):
        following = next_command(vehicle, first, count=False)
        if following is None or vehicle.mission[following].command in NAV_COMMANDS:
            return following
    return None


def next_do_command(vehicle: Vehicle, seq: int) -> int | None:
    """Return the DO command at or after a place, `None` where a navigation command is next (get_next_do_cmd)."""
    following = next_command(vehicle, seq, count=False)
    return None if following is None or vehicle.mission[following].command in NAV_COMMANDS else following
