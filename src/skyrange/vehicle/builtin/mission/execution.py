"""Mission execution: which command runs next, what completes a mission, its pause, and the jump to its landing.

After libraries/AP_Mission/AP_Mission.cpp (`update`, `advance_current_nav_cmd`, `get_next_cmd`, `set_current_cmd`) and
ArduCopter/mode_auto.cpp (`exit_mission`). Navigation commands (`nav_commands`) take time and are flown one after
another; the DO commands between them (`do_commands`) run beside the navigation command that follows.

Pause and continue: MAV_CMD_DO_PAUSE_CONTINUE in AUTO and GUIDED. After ModeAuto::pause and ModeGuided::pause
(ArduCopter/mode_auto.cpp, mode_guided.cpp `pause_control_run`). Both brake to zero velocity here, as GUIDED does there;
ArduCopter's AUTO slows down along its leg, which is the same on a straight one. In GUIDED, targets received during the
pause take effect when it ends: the suspended targets are restored before a message or a timer is processed
(`restore_targets`), and suspended again after it (`suspend_targets`).

Landing sequence of a mission: the nearest DO_LAND_START, and the jump to it. After libraries/AP_Mission/AP_Mission.cpp
(`get_landing_sequence_start`, `jump_to_landing_sequence`, `jump_to_closest_mission_leg` for missions without
DO_RETURN_PATH_START).
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.codec.mavlink import dialect
from skyrange.core import elementary_python
from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin import locations, loop
from skyrange.vehicle.builtin.arming.arming import disarm
from skyrange.vehicle.builtin.fleet import Causes, Fleet, MissionItem, MissionState, SubMode, Timer, Vehicle
from skyrange.vehicle.builtin.flight_modes import auto_rtl
from skyrange.vehicle.builtin.guidance import auto_yaw, wpnav
from skyrange.vehicle.builtin.layout import AutoYawMode, ControlMode, FlightEvent
from skyrange.vehicle.builtin.mission import (
    do_commands,
    nav_commands,
)
from skyrange.vehicle.builtin.mission.command_ids import (
    DO_LAND_START,
    LANDINGS,
    NAV_COMMANDS,
    NAV_LAND,
    NAV_LOITER_TIME,
    NAV_LOITER_TO_ALT,
    NAV_LOITER_UNLIM,
    NAV_RETURN_TO_LAUNCH,
    NAV_SPLINE_WAYPOINT,
    NAV_WAYPOINT,
    SKIPPED_NAV,
    TAKEOFFS,
)
from skyrange.vehicle.builtin.mission.sequence import (
    MAX_COMMANDS,
    is_takeoff_next,
    next_command,
    next_nav_command,
)
from skyrange.vehicle.builtin.modes import Mode

_MIN_REPEAT_NS = 10 * NS_PER_MS
"""Minimum time before an item can be reached again: a loop of jumps between places already reached does not spin."""
_CHANGE_DETECT_COMMANDS = 3  # mis_change_detect_cmd_max
_MAX_JUMP_TEXTS = 30
"""Jumps that are reported at once: the length of ArduPilot's queue of texts (GCS.h `_status_capacity`)."""
_REPORTED_COMMANDS = frozenset((NAV_WAYPOINT, NAV_SPLINE_WAYPOINT, NAV_LOITER_TIME))
_CONTINUE_AFTER_LAND = 1 << 2
"""Bit of MIS_OPTIONS (AP_Mission::Option)."""


def starts_with_takeoff_cmd(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether the mission begins with a take-off, after delays at most (AP_Mission::starts_with_takeoff_cmd)."""
    return is_takeoff_next(vehicle, 1 if fleet.param(vehicle, "MIS_RESTART") == 1 else vehicle.current or 1)


def start_or_resume(fleet: Fleet, vehicle: Vehicle) -> None:
    """Start the mission on entry of AUTO: anew after its end or by MIS_RESTART, else from the current item."""
    anew = fleet.param(vehicle, "MIS_RESTART") == 1 and not vehicle.resume_mission
    vehicle.resume_mission = False
    if vehicle.mission_state == MissionState.COMPLETE or anew:
        reset(vehicle)
    vehicle.mission_state = MissionState.ACTIVE
    vehicle.active_item = None
    update(fleet, vehicle)


def reset(vehicle: Vehicle) -> None:
    """Return to the first item and clear the jump counters."""
    vehicle.current = 0
    vehicle.active_item = None
    vehicle.in_landing_sequence = False
    vehicle.jump_counts.clear()
    vehicle.reached_ns.clear()


def stop(fleet: Fleet, vehicle: Vehicle) -> None:
    """Stop the mission when AUTO is left; the current item is kept."""
    if vehicle.mission_state == MissionState.ACTIVE:
        vehicle.mission_state = MissionState.NOT_STARTED
    vehicle.submode = SubMode.NONE
    do_commands.drop_pending(fleet, vehicle)


def update(fleet: Fleet, vehicle: Vehicle) -> None:
    """Start the current item if the mission runs, the motors are armed and none has been started."""
    if vehicle.mode == Mode.AUTO and vehicle.mission_state == MissionState.ACTIVE and fleet.armed(vehicle):
        if vehicle.active_item is None:
            _advance_nav_command(fleet, vehicle, vehicle.current or 1)
        elif (
            vehicle.auto_armed
            and vehicle.active_item.command in TAKEOFFS
            and fleet.control(vehicle) == ControlMode.IDLE
        ):
            _start_nav_command(fleet, vehicle, vehicle.active_item)


def set_current_cmd(fleet: Fleet, vehicle: Vehicle, seq: int) -> bool:
    """Make an item current (MISSION_SET_CURRENT); 0 restarts. `False` where there is no such item."""
    if seq >= len(vehicle.mission) or len(vehicle.mission) <= 1:
        return False
    if seq == 0 or vehicle.mission_state == MissionState.COMPLETE:
        vehicle.jump_counts.clear()
    vehicle.in_landing_sequence = vehicle.mission[seq].command == DO_LAND_START
    seq = max(seq, 1)
    vehicle.active_item = None
    vehicle.submode = SubMode.NONE
    fleet.set_timer(vehicle, Timer.HOLD)
    if vehicle.mission_state == MissionState.ACTIVE and vehicle.mode == Mode.AUTO and fleet.armed(vehicle):
        _advance_nav_command(fleet, vehicle, seq)
        return vehicle.active_item is not None
    nav_command = next_nav_command(vehicle, seq)
    if nav_command is None:
        return False
    vehicle.current = seq
    if vehicle.mission_state != MissionState.ACTIVE:
        vehicle.mission_state = MissionState.NOT_STARTED
    auto_rtl.update(fleet, vehicle)
    return True


def on_mission_changed(fleet: Fleet, vehicle: Vehicle) -> None:
    """Process a changed mission: an item that is gone is not current; a waypoint in progress is started again.

    The latter only if it or one of the two navigation commands after it has changed (MissionChangeDetector).
    """
    if vehicle.current >= len(vehicle.mission):
        reset(vehicle)
        if vehicle.mode == Mode.AUTO and vehicle.mission_state == MissionState.ACTIVE and not vehicle.has_mission:
            _exit_mission(fleet, vehicle)
            return
        auto_rtl.update(fleet, vehicle)
    if vehicle.mode != Mode.AUTO or vehicle.active_item is None or _upcoming_commands(vehicle) == vehicle.upcoming:
        return
    if vehicle.active_item.command in _REPORTED_COMMANDS and vehicle.mission_state == MissionState.ACTIVE:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_CRITICAL, "Auto mission changed, restarted command")
        fleet.set_timer(vehicle, Timer.HOLD)
        vehicle.active_item = None
        _advance_nav_command(fleet, vehicle, vehicle.current)


def _upcoming_commands(vehicle: Vehicle) -> tuple[object, ...]:
    """Return the contents of the navigation command in progress and of the two after it."""
    commands: list[object] = []
    seq: int | None = vehicle.current
    for _ in range(_CHANGE_DETECT_COMMANDS):
        seq = None if seq is None else next_nav_command(vehicle, seq)
        if seq is None:
            break
        item = vehicle.mission[seq]
        place = (item.x, item.y, item.z)
        commands.append((seq, item.command, item.frame, item.param1, item.param2, item.param3, item.param4, place))
        seq += 1
    return tuple(commands)


def on_event(fleet: Fleet, vehicle: Vehicle, flag: FlightEvent) -> None:
    """Process an event of the loop (arrival, end of a climb, landing) while AUTO flies a command."""
    item = vehicle.active_item
    if item is not None and nav_commands.verify_event(fleet, vehicle, item, flag):
        _complete_command(fleet, vehicle, item)


def on_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    """Process the end of a wait: at a waypoint, above home, or before another check."""
    item = vehicle.active_item
    if item is not None and nav_commands.verify_timer(fleet, vehicle, item):
        _complete_command(fleet, vehicle, item)


def on_landed(fleet: Fleet, vehicle: Vehicle) -> None:
    """Process a landing with idle motors: that of a return goes on, that of NAV_LAND ends the mission by disarming.

    With bit 2 of MIS_OPTIONS the mission goes on where a take-off follows (ModeAuto::verify_land,
    AP_Mission::continue_after_land_check_for_takeoff).
    """
    item = vehicle.active_item
    if item is None:
        return
    may_continue = bool(int(fleet.param(vehicle, "MIS_OPTIONS")) & _CONTINUE_AFTER_LAND)
    if item.command == NAV_RETURN_TO_LAUNCH or (may_continue and is_takeoff_next(vehicle, vehicle.current + 1)):
        _complete_command(fleet, vehicle, item)
    else:
        disarm(fleet, vehicle, "landed", item.causes)


def _complete_command(fleet: Fleet, vehicle: Vehicle, item: MissionItem) -> None:
    """Report that the current command is complete, and start the next."""
    seq = vehicle.current
    again = vehicle.reached_ns.get(seq, -_MIN_REPEAT_NS) + _MIN_REPEAT_NS
    if fleet.now < again:
        fleet.set_timer(vehicle, Timer.HOLD, again)
        return
    vehicle.reached_ns[seq] = fleet.now
    _report_reached(fleet, vehicle)
    if item.command != NAV_LOITER_TO_ALT:  # verify_command returns before it reports this
        vehicle.item_to_report = seq
    if item.command in _REPORTED_COMMANDS:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, f"Reached command #{seq}")
    fleet.note("event.item_reached", vehicle, {"seq": seq, "command": item.command}, item.causes)
    vehicle.active_item = None
    vehicle.submode = SubMode.NONE
    _advance_nav_command(fleet, vehicle, seq + 1)
    _report_reached(fleet, vehicle)


def _report_reached(fleet: Fleet, vehicle: Vehicle) -> None:
    """Send MISSION_ITEM_REACHED, unless a DO command completed in the same pass has replaced the number.

    ArduPilot keeps one number until it is sent (`GCS::send_mission_item_reached_message`), and `AP_Mission::update`
    completes the first DO command after a navigation command in the pass that completes the latter.
    """
    if vehicle.item_to_report:
        fleet.send(vehicle, dialect.MAVLink_mission_item_reached_message(vehicle.item_to_report))
        vehicle.item_to_report = 0


def _advance_nav_command(fleet: Fleet, vehicle: Vehicle, seq: int) -> None:
    """Find the next navigation command and start it, with the DO commands before it; else complete the mission.

    The first DO command runs before the navigation command starts, the others after, as in advance_current_nav_cmd.
    """
    do_commands.drop_pending(fleet, vehicle)
    first = jumps = 0

    def jumped(jump: int, made: int, times: int) -> None:
        nonlocal jumps
        jumps += 1
        if jumps <= _MAX_JUMP_TEXTS:
            most = "unlimited" if times < 0 else str(times)
            fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, f"Mission: {jump} Jump {made}/{most}")

    for _ in range(MAX_COMMANDS):
        following = next_command(vehicle, seq, jumped, count=True)
        if following is None:
            break
        place = following
        item = vehicle.mission[place]
        if item.command in NAV_COMMANDS:
            vehicle.current = place
            if item.command in SKIPPED_NAV:  # start_command fails, and the search goes on
                do_commands.announce_command(fleet, vehicle, place)
                seq = place + 1
                continue
            vehicle.active_item = item
            vehicle.upcoming = _upcoming_commands(vehicle)
            fleet.set_timer(vehicle, Timer.HOLD)
            do_commands.announce_command(fleet, vehicle, place)
            if not _start_nav_command(fleet, vehicle, item):
                _complete_command(fleet, vehicle, item)
            elif first and vehicle.active_item is item:
                do_commands.finish_first(fleet, vehicle, first)
            auto_rtl.update(fleet, vehicle)
            return
        if not first:
            first = place
            do_commands.start_command(fleet, vehicle, place)
        seq = place + 1
    _exit_mission(fleet, vehicle)


def _start_nav_command(fleet: Fleet, vehicle: Vehicle, item: MissionItem) -> bool:
    """Start a navigation command, given the two that follow it; `False` where it is complete at once."""
    if item.command in LANDINGS | TAKEOFFS:
        vehicle.in_landing_sequence = item.command in LANDINGS
    following = next_nav_command(vehicle, vehicle.current + 1)
    then = None if following is None else next_nav_command(vehicle, following + 1)
    after = None if following is None else vehicle.mission[following]
    begun = nav_commands.start_command(fleet, vehicle, item, after, None if then is None else vehicle.mission[then])
    hold_if_paused(fleet, vehicle)
    return begun


def resume(fleet: Fleet, vehicle: Vehicle) -> None:
    """End a pause: continue to the current command along a leg from the point of rest (ModeAuto::resume)."""
    if vehicle.paused and vehicle.active_item is not None:
        vehicle.paused = False
        _start_nav_command(fleet, vehicle, vehicle.active_item)


def _exit_mission(fleet: Fleet, vehicle: Vehicle) -> None:
    """End the mission when no command is left: hold in the air, disarm on the ground (ModeAuto::exit_mission)."""
    vehicle.mission_state = MissionState.COMPLETE
    vehicle.in_landing_sequence = vehicle.paused = False
    vehicle.active_item = None
    do_commands.drop_pending(fleet, vehicle)
    if fleet.landed(vehicle):
        if fleet.armed(vehicle):
            disarm(fleet, vehicle, "mission_exit", vehicle.mode_causes)
    elif fleet.control(vehicle) != ControlMode.LEG or not fleet.legs["reached_destination"][vehicle.row]:
        loop.init_reference(fleet.estimate, fleet.flight, vehicle.row)
        auto_yaw.set_mode(fleet, vehicle, AutoYawMode.HOLD)
        fleet.set_control(vehicle, ControlMode.VELOCITY)


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


def nearest_start(fleet: Fleet, vehicle: Vehicle) -> int | None:
    """Return the DO_LAND_START nearest to the point of rest of the aircraft, in three dimensions; `None` without one.

    One without a place is at the navigation command behind it.
    """
    here = wpnav.stopping_point_of(fleet.estimate, fleet.flight, fleet.settings, vehicle.row)
    nearest, least = None, math.inf
    for seq, item in enumerate(vehicle.mission):
        if seq == 0 or item.command != DO_LAND_START:
            continue
        placed: MissionItem | None = item
        if item.x == 0 and item.y == 0 and item.z == 0.0:
            behind = next_nav_command(vehicle, seq)
            placed = None if behind is None else vehicle.mission[behind]
        if placed is None:
            continue
        place = locations.to_enu(fleet, vehicle, placed.frame, placed.x, placed.y, placed.z)
        away = math.inf if place is None else elementary_python.distance(place, here)
        if nearest is None or away < least:
            nearest, least = seq, away
    return nearest


def jump_to_start(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> bool:
    """Make the nearest DO_LAND_START current; `False` and a text where there is none."""
    seq = nearest_start(fleet, vehicle)
    if seq is None or not set_current_cmd(fleet, vehicle, seq):
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, "Unable to start landing sequence", causes)
        return False
    if vehicle.mode == Mode.AUTO and vehicle.mission_state != MissionState.ACTIVE:  # the mission had ended
        vehicle.resume_mission = True
        start_or_resume(fleet, vehicle)
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, "Landing sequence start", causes)
    return True


def jump_unless_active(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> bool:
    """Make the nearest DO_LAND_START current, unless the mission already flies its landing sequence."""
    if vehicle.mission_state == MissionState.ACTIVE and vehicle.in_landing_sequence:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, "Landing sequence active", causes)
        return True
    return jump_to_start(fleet, vehicle, causes)
