"""Mission execution: which command runs next, and what happens when one is complete.

After libraries/AP_Mission/AP_Mission.cpp (`update`, `advance_current_nav_cmd`, `get_next_cmd`, `set_current_cmd`) and
ArduCopter/mode_auto.cpp (`exit_mission`). Navigation commands (`nav_commands`) take time and are flown one after
another; the DO commands between them (`do_commands`) run beside the navigation command that follows.
"""

from __future__ import annotations

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.builtin import auto_rtl, do_items, facing, flown_items, loop, pausing
from skyrange.vehicle.builtin.arming import disarm
from skyrange.vehicle.builtin.fleet import Craft, Fleet, MissionState, Slot, Stage, Timer
from skyrange.vehicle.builtin.layout import Control, Flag, Heading
from skyrange.vehicle.builtin.mission_kinds import (
    CONDITIONS,
    DELAY,
    LAND,
    LAND_START,
    NAVIGATION,
    RTL,
    SPLINE,
    TAKEOFF,
    TIME,
    TO_ALT,
    WAYPOINT,
)
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.sequence import MAX_ITEMS, next_navigation, resolve

_MIN_REPEAT_NS = NS_PER_S
"""Minimum time before an item can be reached again: a loop of jumps between places already reached does not spin."""
_CHANGE_DETECT_COMMANDS = 3  # mis_change_detect_cmd_max
_MAX_JUMP_TEXTS = 30
"""Jumps that are reported at once: the length of ArduPilot's queue of texts (GCS.h `_status_capacity`)."""
_REPORTED_COMMANDS = frozenset((WAYPOINT, SPLINE, TIME))
_GROUND_COMMANDS = frozenset((TAKEOFF, DELAY))
"""Commands that continue a mission on the ground: a take-off, or a delay between a landing and a take-off."""


def starts_with_takeoff(fleet: Fleet, craft: Craft) -> bool:
    """Whether the first navigation command to be flown is a take-off (AP_Mission::starts_with_takeoff_cmd)."""
    seq = next_navigation(craft, 1 if fleet.param(craft, "MIS_RESTART") == 1 else craft.current or 1)
    return seq is not None and craft.mission[seq].command == TAKEOFF


def start_or_resume(fleet: Fleet, craft: Craft) -> None:
    """Start the mission on entry of AUTO: anew after its end or by MIS_RESTART, else from the current item."""
    anew = fleet.param(craft, "MIS_RESTART") == 1 and not craft.resumes
    craft.resumes = False
    if craft.mission_state == MissionState.COMPLETE or anew:
        reset(craft)
    craft.mission_state = MissionState.ACTIVE
    craft.flown = None
    update(fleet, craft)


def reset(craft: Craft) -> None:
    """Return to the first item and clear the jump counters."""
    craft.current = 0
    craft.flown = None
    craft.in_landing = False
    craft.jumps.clear()
    craft.reached.clear()


def stop(fleet: Fleet, craft: Craft) -> None:
    """Stop the mission when AUTO is left; the current item is kept."""
    if craft.mission_state == MissionState.ACTIVE:
        craft.mission_state = MissionState.NOT_STARTED
    craft.stage = Stage.NONE
    do_items.drop(fleet, craft)


def update(fleet: Fleet, craft: Craft) -> None:
    """Start the current item if the mission runs, the motors are armed and none has been started."""
    if craft.mode == Mode.AUTO and craft.mission_state == MissionState.ACTIVE and fleet.armed(craft):
        if craft.flown is None:
            _advance_nav_command(fleet, craft, craft.current or 1)
        elif craft.ready and craft.flown.command == TAKEOFF and fleet.control(craft) == Control.IDLE:
            _start_nav_command(fleet, craft, craft.flown)


def set_current(fleet: Fleet, craft: Craft, seq: int) -> bool:
    """Make an item current (MISSION_SET_CURRENT); 0 restarts. `False` where there is no such item."""
    if seq >= len(craft.mission) or len(craft.mission) <= 1:
        return False
    if seq == 0 or craft.mission_state == MissionState.COMPLETE:
        craft.jumps.clear()
    craft.in_landing = craft.mission[seq].command == LAND_START
    seq = max(seq, 1)
    craft.flown = None
    craft.stage = Stage.NONE
    fleet.timer(craft, Timer.HOLD)
    if craft.mission_state == MissionState.ACTIVE and craft.mode == Mode.AUTO and fleet.armed(craft):
        _advance_nav_command(fleet, craft, seq)
        return craft.flown is not None
    found = next_navigation(craft, seq)
    if found is None:
        return False
    craft.current = seq
    if craft.mission_state != MissionState.ACTIVE:
        craft.mission_state = MissionState.NOT_STARTED
    auto_rtl.look(fleet, craft)
    return True


def changed(fleet: Fleet, craft: Craft) -> None:
    """Process a changed mission: an item that is gone is not current; a waypoint in progress is started again.

    The latter only if it or one of the two navigation commands after it has changed (MissionChangeDetector).
    """
    if craft.current >= len(craft.mission):
        reset(craft)
        if craft.mode == Mode.AUTO and craft.mission_state == MissionState.ACTIVE and not craft.sees_mission:
            _exit_mission(fleet, craft)
            return
        auto_rtl.look(fleet, craft)
    if craft.mode != Mode.AUTO or craft.flown is None or _upcoming_commands(craft) == craft.ahead:
        return
    if craft.flown.command in _REPORTED_COMMANDS and craft.mission_state == MissionState.ACTIVE:
        fleet.text(craft, dialect.MAV_SEVERITY_CRITICAL, "Auto mission changed, restarted command")
        fleet.timer(craft, Timer.HOLD)
        craft.flown = None
        _advance_nav_command(fleet, craft, craft.current)


def _upcoming_commands(craft: Craft) -> tuple[object, ...]:
    """Return the contents of the navigation command in progress and of the two after it."""
    found: list[object] = []
    seq: int | None = craft.current
    for _ in range(_CHANGE_DETECT_COMMANDS):
        seq = None if seq is None else next_navigation(craft, seq)
        if seq is None:
            break
        slot = craft.mission[seq]
        place = (slot.x, slot.y, slot.z)
        found.append((seq, slot.command, slot.frame, slot.param1, slot.param2, slot.param3, slot.param4, place))
        seq += 1
    return tuple(found)


def on_flag(fleet: Fleet, craft: Craft, flag: Flag) -> None:
    """Process an event of the loop (arrival, end of a climb, landing) while AUTO flies a command."""
    slot = craft.flown
    if slot is not None and flown_items.on_flag(fleet, craft, slot, flag):
        _complete_command(fleet, craft, slot)


def waited(fleet: Fleet, craft: Craft) -> None:
    """Process the end of a wait: at a waypoint, above home, or before another check."""
    slot = craft.flown
    if slot is not None and flown_items.waited(fleet, craft, slot):
        _complete_command(fleet, craft, slot)


def settled(fleet: Fleet, craft: Craft) -> None:
    """Process a landing with idle motors: it ends the mission unless a take-off follows."""
    slot = craft.flown
    if slot is None:
        return
    following = next_navigation(craft, craft.current + 1)
    if slot.command == RTL or (following is not None and craft.mission[following].command in _GROUND_COMMANDS):
        _complete_command(fleet, craft, slot)
    else:
        disarm(fleet, craft, "landed", slot.causes)


def _complete_command(fleet: Fleet, craft: Craft, slot: Slot) -> None:
    """Report that the current command is complete, and start the next."""
    seq = craft.current
    again = craft.reached.get(seq, -_MIN_REPEAT_NS) + _MIN_REPEAT_NS
    if fleet.now < again:
        fleet.timer(craft, Timer.HOLD, again)
        return
    craft.reached[seq] = fleet.now
    _report_reached(fleet, craft)
    if slot.command != TO_ALT:  # verify_command returns before it reports this
        craft.untold = seq
    if slot.command in _REPORTED_COMMANDS:
        fleet.text(craft, dialect.MAV_SEVERITY_INFO, f"Reached command #{seq}")
    fleet.note("event.item_reached", craft, {"seq": seq, "command": slot.command}, slot.causes)
    craft.flown = None
    craft.stage = Stage.NONE
    _advance_nav_command(fleet, craft, seq + 1)
    _report_reached(fleet, craft)


def _report_reached(fleet: Fleet, craft: Craft) -> None:
    """Send MISSION_ITEM_REACHED, unless a DO command completed in the same pass has replaced the number.

    ArduPilot keeps one number until it is sent (`GCS::send_mission_item_reached_message`), and `AP_Mission::update`
    completes the first DO command after a navigation command in the pass that completes the latter.
    """
    if craft.untold:
        fleet.send(craft, dialect.MAVLink_mission_item_reached_message(craft.untold))
        craft.untold = 0


def _advance_nav_command(fleet: Fleet, craft: Craft, seq: int) -> None:
    """Find the next navigation command and start it, with the DO commands before it; else complete the mission.

    The first DO command runs before the navigation command starts, the others after, as in advance_current_nav_cmd.
    """
    do_items.drop(fleet, craft)
    first = jumps = 0

    def jumped(jump: int, made: int, times: int) -> None:
        nonlocal jumps
        jumps += 1
        if jumps <= _MAX_JUMP_TEXTS:
            most = "unlimited" if times < 0 else str(times)
            fleet.text(craft, dialect.MAV_SEVERITY_INFO, f"Mission: {jump} Jump {made}/{most}")

    for _ in range(MAX_ITEMS):
        found = resolve(craft, seq, True, jumped)
        if found is None:
            break
        place = found
        slot = craft.mission[place]
        if slot.command in NAVIGATION:
            craft.current = place
            craft.flown = slot
            craft.ahead = _upcoming_commands(craft)
            fleet.timer(craft, Timer.HOLD)
            do_items.announce(fleet, craft, place)
            if not _start_nav_command(fleet, craft, slot):
                _complete_command(fleet, craft, slot)
            elif first and craft.flown is slot:
                _run_do_commands(fleet, craft, first)
            auto_rtl.look(fleet, craft)
            return
        if not first:
            first = place
            if slot.command not in CONDITIONS:
                do_items.start(fleet, craft, place)
        seq = place + 1
    _exit_mission(fleet, craft)


def _run_do_commands(fleet: Fleet, craft: Craft, first: int) -> None:
    """Run the DO commands from the first on, which has already run unless it is a condition."""
    if craft.mission[first].command in CONDITIONS:
        do_items.run(fleet, craft, first)
    else:
        do_items.done(fleet, craft, first)
        _report_reached(fleet, craft)
        do_items.run(fleet, craft, first + 1)


def _start_nav_command(fleet: Fleet, craft: Craft, slot: Slot) -> bool:
    """Start a navigation command, given the two that follow it; `False` where it is complete at once."""
    if slot.command in (LAND, TAKEOFF):
        craft.in_landing = slot.command == LAND
    following = next_navigation(craft, craft.current + 1)
    then = None if following is None else next_navigation(craft, following + 1)
    after = None if following is None else craft.mission[following]
    begun = flown_items.begin(fleet, craft, slot, after, None if then is None else craft.mission[then])
    pausing.stay(fleet, craft)
    return begun


def go_on(fleet: Fleet, craft: Craft) -> None:
    """End a pause: continue to the current command along a leg from the point of rest (ModeAuto::resume)."""
    if craft.paused and craft.flown is not None:
        craft.paused = False
        _start_nav_command(fleet, craft, craft.flown)


def _exit_mission(fleet: Fleet, craft: Craft) -> None:
    """End the mission when no command is left: hold in the air, disarm on the ground (ModeAuto::exit_mission)."""
    craft.mission_state = MissionState.COMPLETE
    craft.in_landing = craft.paused = False
    craft.flown = None
    do_items.drop(fleet, craft)
    if fleet.landed(craft):
        if fleet.armed(craft):
            disarm(fleet, craft, "mission_exit", craft.mode_causes)
    elif fleet.control(craft) != Control.LEG or not fleet.legs["reached"][craft.row]:
        loop.hold(fleet.estimate, fleet.flight, craft.row)
        facing.set_kind(fleet, craft, Heading.HOLD)
        fleet.fly(craft, Control.VELOCITY)
