"""Pause and continue: MAV_CMD_DO_PAUSE_CONTINUE in AUTO and GUIDED.

After ModeAuto::pause and ModeGuided::pause (ArduCopter/mode_auto.cpp, mode_guided.cpp `pause_control_run`). Both brake
to zero velocity here, as GUIDED does there; ArduCopter's AUTO slows down along its leg, which is the same on a straight
one. In GUIDED, targets received during the pause take effect when it ends: the suspended targets are restored before a
message or a timer is processed (`restore_targets`), and suspended again after it (`suspend_targets`).
"""

from __future__ import annotations

from typing import Final

from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.guidance import auto_yaw
from skyrange.vehicle.builtin.layout import AutoYawMode, ControlMode
from skyrange.vehicle.builtin.mission.command_ids import (
    NAV_LAND,
    NAV_LOITER_TIME,
    NAV_LOITER_UNLIM,
    NAV_SPLINE_WAYPOINT,
    NAV_WAYPOINT,
)
from skyrange.vehicle.builtin.modes import Mode

_LEG_COMMANDS: Final = frozenset((NAV_WAYPOINT, NAV_SPLINE_WAYPOINT, NAV_LOITER_UNLIM, NAV_LOITER_TIME, NAV_LAND))
"""Commands flown in ModeAuto's sub-mode WP."""
_SUSPENDED_FIELDS: Final = ("control", "target_vel", "target_acc", "auto_yaw_mode", "target_yaw", "target_yaw_rate")
"""Fields that a pause overwrites."""


def _is_on_leg(fleet: Fleet, vehicle: Vehicle) -> bool:
    return (
        vehicle.active_item is not None
        and vehicle.active_item.command in _LEG_COMMANDS
        and fleet.control(vehicle) == ControlMode.LEG
    )


def pause(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Pause; `False` where the mode cannot, or AUTO is not on its way to a place."""
    if vehicle.mode == Mode.GUIDED:
        vehicle.paused = True
    elif vehicle.mode == Mode.AUTO and not vehicle.paused:
        vehicle.paused = _is_on_leg(fleet, vehicle) and not fleet.legs["reached_destination"][vehicle.row]
        hold_if_paused(fleet, vehicle)
    return vehicle.paused


def hold_if_paused(fleet: Fleet, vehicle: Vehicle) -> None:
    """Keep a command that has just started paused, unless it cannot be paused."""
    if vehicle.paused and vehicle.mode == Mode.AUTO:
        vehicle.paused = _is_on_leg(fleet, vehicle)
        if vehicle.paused:
            fleet.set_control(vehicle, ControlMode.VELOCITY)


def restore_targets(fleet: Fleet, vehicle: Vehicle) -> None:
    """Restore the suspended targets, so that a handler can read or change them."""
    if fleet.armed(vehicle):
        for name, value in vehicle.suspended_targets:
            fleet.flight[name][vehicle.row] = value
    vehicle.suspended_targets = ()


def suspend_targets(fleet: Fleet, vehicle: Vehicle) -> None:
    """Suspend the targets and hold: at rest in the air, with idle motors on the ground."""
    if not vehicle.paused or vehicle.mode != Mode.GUIDED or not fleet.armed(vehicle):
        return
    row = vehicle.row
    vehicle.suspended_targets = tuple((name, fleet.flight[name][row].copy()) for name in _SUSPENDED_FIELDS)
    auto_yaw.set_mode(fleet, vehicle, AutoYawMode.HOLD)
    fleet.set_control(vehicle, ControlMode.IDLE if fleet.landed(vehicle) else ControlMode.VELOCITY)
