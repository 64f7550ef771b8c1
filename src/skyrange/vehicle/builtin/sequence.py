"""Which item of a mission comes next? Jumps followed, as libraries/AP_Mission/AP_Mission.cpp `get_next_cmd` does."""

from __future__ import annotations

from collections.abc import Callable

from skyrange.vehicle.builtin.fleet import Craft
from skyrange.vehicle.builtin.mission_kinds import JUMP, NAVIGATION

_MAX_JUMPS = 64  # get_next_cmd
MAX_ITEMS = 255
"""Of advance_current_nav_cmd: a loop of jumps and DO items ends the mission."""


Jumped = Callable[[int, int, int], None]
"""Told of each jump made: its item, how often it has been made, and how often it may be (-1 for ever)."""


def resolve(craft: Craft, seq: int, count: bool, jumped: Jumped | None = None) -> int | None:
    """The first item from `seq` on that is no jump, following jumps; counts them as made where `count`."""
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
    """The navigation item that would be flown from `seq` on; looks without counting jumps."""
    for _ in range(MAX_ITEMS):
        found = resolve(craft, seq, count=False)
        if found is None or craft.mission[found].command in NAVIGATION:
            return found
        seq = found + 1
    return None


def next_do(craft: Craft, seq: int) -> int | None:
    """The DO item that comes at or behind a place, `None` where a navigation item is next (get_next_do_cmd)."""
    found = resolve(craft, seq, count=False)
    return None if found is None or craft.mission[found].command in NAVIGATION else found
