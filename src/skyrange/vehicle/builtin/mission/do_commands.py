"""DO and CONDITION commands of a mission, which run beside the navigation command that follows them.

After AP_Mission.cpp (`advance_current_do_cmd`) and ArduCopter/mode_auto.cpp: the commands between two navigation
commands run one after another while the second of these is flown. A CONDITION command delays those behind it; all that
are still pending are dropped when the next navigation command starts. Each one completed is reported with
MISSION_ITEM_REACHED.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.core import elementary
from skyrange.core.time import NS_PER_MS, NS_PER_S, from_seconds
from skyrange.vehicle.builtin import fence, locations
from skyrange.vehicle.builtin.fleet import Fleet, MissionItem, Timer, Vehicle
from skyrange.vehicle.builtin.guidance import auto_yaw
from skyrange.vehicle.builtin.layout import AutoYawMode, ControlMode
from skyrange.vehicle.builtin.mission.command_ids import (
    COMMAND_NAMES,
    CONDITION_DELAY,
    CONDITION_DISTANCE,
    CONDITION_YAW,
    DO_AUX_FUNCTION,
    DO_CHANGE_SPEED,
    DO_FENCE_ENABLE,
    DO_GUIDED_LIMITS,
    DO_LAND_START,
    DO_PARACHUTE,
    DO_SET_HOME,
    DO_SET_ROI,
    DO_SET_ROI_LOCATION,
    DO_SET_ROI_NONE,
    JUMP_TAG,
    SILENT,
    SKIPPED,
)
from skyrange.vehicle.builtin.mission.sequence import next_do_command
from skyrange.vehicle.builtin.modes import Mode

_PASS_NS = 10 * NS_PER_MS
"""Time between two steps of the commands; ArduCopter's passes are 2.5 ms apart, at its own rate."""
_SPEED_MIN_MPS = 0.1  # AC_WPNav.cpp WPNAV_WP_SPEED_MIN_CMS
_SPEED_MAX_MPS = 100.0  # faster than any multirotor: keeps an absurd request finite
_WAIT_MAX_S = 86_400.0 * 365.0


def start_command(fleet: Fleet, vehicle: Vehicle, seq: int) -> None:
    """Run one DO command, or start one CONDITION command."""
    item = vehicle.mission[seq]
    command = item.command
    announce_command(fleet, vehicle, seq)
    if command in (DO_LAND_START, DO_PARACHUTE):
        vehicle.in_landing_sequence = True
    if command == DO_CHANGE_SPEED and item.param2 > 0.0:
        change_speed(fleet, vehicle, int(item.param1), item.param2)
    elif command == DO_SET_HOME:
        _set_home(fleet, vehicle, item)
    elif command in (DO_SET_ROI, DO_SET_ROI_LOCATION, DO_SET_ROI_NONE):
        set_roi(fleet, vehicle, item.frame, item.x, item.y, item.z)
    elif command == DO_GUIDED_LIMITS:
        vehicle.guided_limits = (item.param1, item.param2, item.param3, item.param4)
    elif command == DO_AUX_FUNCTION:
        vehicle.aux_functions.append((int(item.param1), int(item.param2), item.causes))
        fleet.aux_pending = True
    elif command == DO_FENCE_ENABLE:
        fence.handle_do_fence_enable(fleet, vehicle, int(item.param1), 0)
    elif command == CONDITION_DELAY:
        vehicle.condition = (command, float(fleet.now + from_seconds(min(max(item.param1, 0.0), _WAIT_MAX_S))))
    elif command == CONDITION_DISTANCE:
        vehicle.condition = (command, max(item.param1, 0.0))
    elif command == CONDITION_YAW:
        auto_yaw.set_fixed_yaw(fleet, vehicle, item.param1, item.param2, int(item.param3), relative=item.param4 > 0.0)
        vehicle.condition = (command, 0.0)


def announce_command(fleet: Fleet, vehicle: Vehicle, seq: int) -> None:
    """Send the text of an item that starts (AP_Mission::start_command)."""
    item = vehicle.mission[seq]
    tag = f" {int(item.param1)}" if item.command == JUMP_TAG else ""
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, f"Mission: {seq} {COMMAND_NAMES[item.command]}{tag}")


def report_complete(fleet: Fleet, vehicle: Vehicle, seq: int) -> None:
    """Report one completed command, unless AP_Mission completes it itself."""
    command = vehicle.mission[seq].command
    if command in SKIPPED:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, f"Skipping invalid cmd #{command}")
    if command not in SILENT:
        vehicle.item_to_report = 0
        fleet.send(vehicle, dialect.MAVLink_mission_item_reached_message(seq))


def drop_pending(fleet: Fleet, vehicle: Vehicle) -> None:
    """Drop the pending commands."""
    vehicle.next_do, vehicle.do_started = 0, False
    vehicle.condition = (0, 0.0)
    fleet.set_timer(vehicle, Timer.CONDITION)


def finish_first(fleet: Fleet, vehicle: Vehicle, seq: int) -> None:
    """Complete the command that started before the navigation command, or wait for its condition; then run the rest."""
    vehicle.next_do, vehicle.do_started = seq, True
    if vehicle.condition[0] == CONDITION_YAW:  # which the start of the navigation command has replaced
        auto_yaw.set_mode(fleet, vehicle, AutoYawMode.FIXED)
    on_timer(fleet, vehicle)


def on_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    """Start the command that is due, or complete it if its condition is met (AP_Mission::update).

    Each pass of ArduCopter's loop does one of both, so a navigation command that is complete at once drops the rest.
    """
    seq = vehicle.next_do
    if seq == 0 or seq >= len(vehicle.mission) or vehicle.active_item is None:
        return
    if not vehicle.do_started:
        start_command(fleet, vehicle, seq)
        vehicle.do_started = True
    elif _condition_met(fleet, vehicle):
        drop_pending(fleet, vehicle)
        report_complete(fleet, vehicle, seq)
        following = next_do_command(vehicle, seq + 1)
        if following is None or following <= seq:  # after a jump back, ArduCopter repeats them until the next waypoint
            return
        vehicle.next_do = following
    fleet.set_timer(vehicle, Timer.CONDITION, fleet.now + _PASS_NS)


def _condition_met(fleet: Fleet, vehicle: Vehicle) -> bool:
    kind, value = vehicle.condition
    if kind == CONDITION_DELAY:
        return fleet.now > value
    if kind == CONDITION_DISTANCE:
        return wp_distance_m(fleet, vehicle) < value
    if kind == CONDITION_YAW:  # whatever else has set another yaw meanwhile (ModeAuto::verify_yaw)
        auto_yaw.resume_fixed_yaw(fleet, vehicle)
        return auto_yaw.reached_fixed_yaw_target(fleet, vehicle)
    return True


def wp_distance_m(fleet: Fleet, vehicle: Vehicle) -> float:
    """Return the horizontal distance to the present destination (ModeAuto::wp_distance_m); 0 without one."""
    if not vehicle.paused and fleet.control(vehicle) not in (ControlMode.LEG, ControlMode.POSITION, ControlMode.CIRCLE):
        return 0.0
    here, goal = fleet.position(vehicle), fleet.flight["target_pos"][vehicle.row].tolist()
    return elementary.hypot(goal[0] - here[0], goal[1] - here[1])


def change_speed(fleet: Fleet, vehicle: Vehicle, kind: int, speed_mps: float) -> bool:
    """Set the horizontal (0, 1), climb (2) or descent (3) speed until the mode changes; `False` for other kinds."""
    name = {0: "speed_xy", 1: "speed_xy", 2: "speed_up", 3: "speed_down"}.get(kind)
    if name is None:
        return False
    if speed_mps >= _SPEED_MIN_MPS:
        fleet.flight[name][vehicle.row] = min(speed_mps, _SPEED_MAX_MPS)
        fleet.flight["speed_changed"][vehicle.row] = 1
        if vehicle.mode == Mode.AUTO:
            vehicle.speed_overrides[name] = min(speed_mps, _SPEED_MAX_MPS)
    return True


def restore_speeds(fleet: Fleet, vehicle: Vehicle) -> None:
    """Set the speeds that the mission has set; a landing and a return have speeds of their own (ModeAuto::wp_start)."""
    for name, speed_mps in vehicle.speed_overrides.items():
        fleet.flight[name][vehicle.row] = speed_mps


def set_roi(fleet: Fleet, vehicle: Vehicle, frame: int, lat_e7: int, lon_e7: int, alt_m: float) -> None:
    """Set a region of interest, or clear it where all values are zero (AutoYaw::set_roi)."""
    if lat_e7 == 0 and lon_e7 == 0 and alt_m == 0.0:
        auto_yaw.set_roi(fleet, vehicle, None)
    else:
        auto_yaw.set_roi(fleet, vehicle, locations.to_enu(fleet, vehicle, frame, lat_e7, lon_e7, alt_m))


def _set_home(fleet: Fleet, vehicle: Vehicle, item: MissionItem) -> None:
    here = item.param1 == 1.0 or (item.x == 0 and item.y == 0 and item.z == 0.0)
    place = None if here else locations.to_enu(fleet, vehicle, item.frame, item.x, item.y, item.z)
    locations.set_home(fleet, vehicle, fleet.position(vehicle) if place is None else place, item.causes, lock=False)


def seconds_until_utc(fleet: Fleet, vehicle: Vehicle, hour: float, minute: float, second: float) -> float:
    """Return seconds until a time of day by the autopilot's clock (AP_RTC::get_time_utc); 0 if that was never set.

    The first part that is not -1 says how often the time comes: each day, each hour or each minute. A later -1 counts
    as a number.
    """
    requested = (int(hour), int(minute), int(second))
    first = next((place for place, part in enumerate(requested) if part != -1), None)
    if first is None or not fleet.clocks.known[vehicle.row]:
        return 0.0
    now_ms = int(fleet.clocks.utc_us(np.array([vehicle.row]), fleet.now)[0]) // 1000
    now = (now_ms // 3_600_000 % 24, now_ms // 60_000 % 60, now_ms // 1000 % 60)
    left_ms = -(now_ms % 1000)
    for part_ms, ask, part in list(zip(_PARTS_MS, requested, now, strict=True))[first:]:
        left_ms += (ask - part) * part_ms
    if left_ms < 0:
        left_ms += _PERIODS_MS[first]
    return (left_ms & 0xFFFFFFFF) / 1000.0


_PARTS_MS: Final = (3_600_000, 60_000, 1000)
_PERIODS_MS: Final = (86_400_000, 3_600_000, 60_000)
MAX_WAIT_NS: Final = int(_WAIT_MAX_S) * NS_PER_S
