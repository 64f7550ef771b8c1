"""Order of mission commands: the next command from a place on, with jumps followed (AP_Mission.cpp `get_next_cmd`)."""

from __future__ import annotations

from collections.abc import Callable

from skyrange.vehicle.builtin.fleet import Craft
from skyrange.vehicle.builtin.mission_kinds import JUMP, NAVIGATION

_MAX_JUMPS = 64  # get_next_cmd
MAX_ITEMS = 255
"""Limit of advance_current_nav_cmd: a loop of jumps and DO commands ends the mission."""


Jumped = Callable[[int, int, int], None]
"""Called for each jump made: its item, how often it was made, and how often it may be (-1 unlimited)."""


def resolve(craft: Craft, seq: int, count: bool, jumped: Jumped | None = None) -> int | None:
    """Return the first item from `seq` on that is not a jump, following jumps; with `count`, count them as made."""
    made = craft.jumps if count else dict(craft.jumps)
    for _ in range(_MAX_JUMPS):
        if seq >= len(craft.mission):
            return None
        slot = craft.mission[seq]
        if slot.command != JUMP:
            return seq
        target, times = int(slot.param1), int(slot.param2)
        if not 0 < target < len(craft.mission):
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


def next_navigation(craft: Craft, seq: int) -> int | None:
    """Return the navigation command that would be flown from `seq` on, without counting jumps."""
    for _ in range(MAX_ITEMS):
        found = resolve(craft, seq, count=False)
        if found is None or craft.mission[found].command in NAVIGATION:
            return found
        seq = found + 1
    return None


def next_do(craft: Craft, seq: int) -> int | None:
    """Return the DO command at or after a place, `None` where a navigation command is next (get_next_do_cmd)."""
    found = resolve(craft, seq, count=False)
    return None if found is None or craft.mission[found].command in NAVIGATION else found
