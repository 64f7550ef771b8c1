"""Pause and continue: MAV_CMD_DO_PAUSE_CONTINUE in AUTO and GUIDED.

After ModeAuto::pause and ModeGuided::pause (ArduCopter/mode_auto.cpp, mode_guided.cpp `pause_control_run`). Both brake
to zero velocity here, as GUIDED does there; ArduCopter's AUTO slows down along its leg, which is the same on a straight
one. In GUIDED, targets received during the pause take effect when it ends: the suspended targets are restored before a
message or a timer is processed (`restore_targets`), and suspended again after it (`suspend_targets`).
"""

from __future__ import annotations

from typing import Final

from skyrange.vehicle.builtin import facing
from skyrange.vehicle.builtin.fleet import Craft, Fleet
from skyrange.vehicle.builtin.layout import Control, Heading
from skyrange.vehicle.builtin.mission_kinds import LAND, SPLINE, TIME, UNLIM, WAYPOINT
from skyrange.vehicle.builtin.modes import Mode

_LEG_COMMANDS: Final = frozenset((WAYPOINT, SPLINE, UNLIM, TIME, LAND))
"""Commands flown in ModeAuto's sub-mode WP."""
_SUSPENDED_FIELDS: Final = ("control", "target_vel", "target_acc", "heading", "target_yaw", "target_yaw_rate")
"""Fields that a pause overwrites."""


def _is_on_leg(fleet: Fleet, craft: Craft) -> bool:
    return craft.flown is not None and craft.flown.command in _LEG_COMMANDS and fleet.control(craft) == Control.LEG


def pause(fleet: Fleet, craft: Craft) -> bool:
    """Pause; `False` where the mode cannot, or AUTO is not on its way to a place."""
    if craft.mode == Mode.GUIDED:
        craft.paused = True
    elif craft.mode == Mode.AUTO and not craft.paused:
        craft.paused = _is_on_leg(fleet, craft) and not fleet.legs["reached"][craft.row]
        stay(fleet, craft)
    return craft.paused


def stay(fleet: Fleet, craft: Craft) -> None:
    """Keep a command that has just started paused, unless it cannot be paused."""
    if craft.paused and craft.mode == Mode.AUTO:
        craft.paused = _is_on_leg(fleet, craft)
        if craft.paused:
            fleet.fly(craft, Control.VELOCITY)


def lift(fleet: Fleet, craft: Craft) -> None:
    """Restore the suspended targets, so that a handler can read or change them."""
    if fleet.armed(craft):
        for name, value in craft.beneath:
            fleet.flight[name][craft.row] = value
    craft.beneath = ()


def settle(fleet: Fleet, craft: Craft) -> None:
    """Suspend the targets and hold: at rest in the air, with idle motors on the ground."""
    if not craft.paused or craft.mode != Mode.GUIDED or not fleet.armed(craft):
        return
    row = craft.row
    craft.beneath = tuple((name, fleet.flight[name][row].copy()) for name in _SUSPENDED_FIELDS)
    facing.set_kind(fleet, craft, Heading.HOLD)
    fleet.fly(craft, Control.IDLE if fleet.landed(craft) else Control.VELOCITY)
