"""Order of mission commands: the next command from a place on, with jumps followed (AP_Mission.cpp `get_next_cmd`)."""

from __future__ import annotations

from collections.abc import Callable

from skyrange.vehicle.builtin.fleet import Vehicle
from skyrange.vehicle.builtin.mission.command_ids import DO_JUMP, NAV_COMMANDS

_MAX_JUMPS = 64  # get_next_cmd
MAX_COMMANDS = 255
"""Limit of advance_current_nav_cmd: a loop of jumps and DO commands ends the mission."""


JumpObserver = Callable[[int, int, int], None]
"""Called for each jump made: its item, how often it was made, and how often it may be (-1 unlimited)."""


def next_command(vehicle: Vehicle, seq: int, count: bool, jumped: JumpObserver | None = None) -> int | None:
    """Return the first item from `seq` on that is not a jump, following jumps; with `count`, count them as made."""
    made = vehicle.jump_counts if count else dict(vehicle.jump_counts)
    for _ in range(_MAX_JUMPS):
        if seq >= len(vehicle.mission):
            return None
        item = vehicle.mission[seq]
        if item.command != DO_JUMP:
            return seq
        target, times = int(item.param1), int(item.param2)
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


def next_nav_command(vehicle: Vehicle, seq: int) -> int | None:
    """Return the navigation command that would be flown from `seq` on, without counting jumps."""
    for _ in range(MAX_COMMANDS):
        found = next_command(vehicle, seq, count=False)
        if found is None or vehicle.mission[found].command in NAV_COMMANDS:
            return found
        seq = found + 1
    return None


def next_do_command(vehicle: Vehicle, seq: int) -> int | None:
    """Return the DO command at or after a place, `None` where a navigation command is next (get_next_do_cmd)."""
    found = next_command(vehicle, seq, count=False)
    return None if found is None or vehicle.mission[found].command in NAV_COMMANDS else found
