"""How is a mission flown? Which item is next, and what happens when one is done.

After libraries/AP_Mission/AP_Mission.cpp (`update`, `advance_current_nav_cmd`, `get_next_cmd`, `set_current_cmd`) and
ArduCopter/mode_auto.cpp (`exit_mission`). Navigation items (`flown_items`) take time and are flown one after
another; the DO items between them (`do_items`) go with the one behind them.
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

_AGAIN_NS = NS_PER_S
"""An item is not reached again sooner than this: a loop of jumps over places that it is at already does not spin."""
_LOOK_AHEAD = 3  # mis_change_detect_cmd_max
_TEXTS = 30
"""Jumps that are told at once: what ArduPilot's queue of texts holds (GCS.h `_status_capacity`)."""
_TOLD = frozenset((WAYPOINT, SPLINE, TIME))
_AFTER_LANDING = frozenset((TAKEOFF, DELAY))
"""Items that go on from the ground: a delay may be waited out there, between a landing and a take-off."""


def starts_with_takeoff(fleet: Fleet, craft: Craft) -> bool:
    """Whether the first navigation item to be flown is a take-off (AP_Mission::starts_with_takeoff_cmd)."""
    seq = next_navigation(craft, 1 if fleet.param(craft, "MIS_RESTART") == 1 else craft.current or 1)
    return seq is not None and craft.mission[seq].command == TAKEOFF


def start_or_resume(fleet: Fleet, craft: Craft) -> None:
    """AUTO was entered: begin anew after the end or where MIS_RESTART says so, else go on with the item left."""
    anew = fleet.param(craft, "MIS_RESTART") == 1 and not craft.resumes
    craft.resumes = False
    if craft.mission_state == MissionState.COMPLETE or anew:
        reset(craft)
    craft.mission_state = MissionState.ACTIVE
    craft.flown = None
    update(fleet, craft)


def reset(craft: Craft) -> None:
    """Back to the first item, jump counters cleared."""
    craft.current = 0
    craft.flown = None
    craft.in_landing = False
    craft.jumps.clear()
    craft.reached.clear()


def stop(fleet: Fleet, craft: Craft) -> None:
    """AUTO is left: the item under way is kept for the way back."""
    if craft.mission_state == MissionState.ACTIVE:
        craft.mission_state = MissionState.NOT_STARTED
    craft.stage = Stage.NONE
    do_items.drop(fleet, craft)


def update(fleet: Fleet, craft: Craft) -> None:
    """Start the item that is due, if the mission runs, the motors are armed and none has been started."""
    if craft.mode == Mode.AUTO and craft.mission_state == MissionState.ACTIVE and fleet.armed(craft):
        if craft.flown is None:
            _advance(fleet, craft, craft.current or 1)
        elif craft.ready and craft.flown.command == TAKEOFF and fleet.control(craft) == Control.IDLE:
            _begin(fleet, craft, craft.flown)


def set_current(fleet: Fleet, craft: Craft, seq: int) -> bool:
    """Make an item current, as MISSION_SET_CURRENT asks; 0 restarts. `False` where there is no such item."""
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
        _advance(fleet, craft, seq)
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
    """The mission was rewritten: an item that is gone is not current; a waypoint under way is started anew.

    The latter only where it or one of the two navigation items behind it is another now (MissionChangeDetector).
    """
    if craft.current >= len(craft.mission):
        reset(craft)
        if craft.mode == Mode.AUTO and craft.mission_state == MissionState.ACTIVE and not craft.sees_mission:
            _complete(fleet, craft)
            return
        auto_rtl.look(fleet, craft)
    if craft.mode != Mode.AUTO or craft.flown is None or _ahead(craft) == craft.ahead:
        return
    if craft.flown.command in _TOLD and craft.mission_state == MissionState.ACTIVE:
        fleet.text(craft, dialect.MAV_SEVERITY_CRITICAL, "Auto mission changed, restarted command")
        fleet.timer(craft, Timer.HOLD)
        craft.flown = None
        _advance(fleet, craft, craft.current)


def _ahead(craft: Craft) -> tuple[object, ...]:
    """What the navigation item under way and the two behind it say."""
    found: list[object] = []
    seq: int | None = craft.current
    for _ in range(_LOOK_AHEAD):
        seq = None if seq is None else next_navigation(craft, seq)
        if seq is None:
            break
        slot = craft.mission[seq]
        place = (slot.x, slot.y, slot.z)
        found.append((seq, slot.command, slot.frame, slot.param1, slot.param2, slot.param3, slot.param4, place))
        seq += 1
    return tuple(found)


def on_flag(fleet: Fleet, craft: Craft, flag: Flag) -> None:
    """The loop reports an arrival, a climb done or a landing while AUTO flies an item."""
    slot = craft.flown
    if slot is not None and flown_items.on_flag(fleet, craft, slot, flag):
        _reached(fleet, craft, slot)


def waited(fleet: Fleet, craft: Craft) -> None:
    """A wait is over: at a waypoint, above home, or for another look."""
    slot = craft.flown
    if slot is not None and flown_items.waited(fleet, craft, slot):
        _reached(fleet, craft, slot)


def settled(fleet: Fleet, craft: Craft) -> None:
    """It stands on the ground with idle motors: the landing item ends the mission unless a take-off follows."""
    slot = craft.flown
    if slot is None:
        return
    following = next_navigation(craft, craft.current + 1)
    if slot.command == RTL or (following is not None and craft.mission[following].command in _AFTER_LANDING):
        _reached(fleet, craft, slot)
    else:
        disarm(fleet, craft, "landed", slot.causes)


def _reached(fleet: Fleet, craft: Craft, slot: Slot) -> None:
    """Say that the current item is done, and start the next."""
    seq = craft.current
    again = craft.reached.get(seq, -_AGAIN_NS) + _AGAIN_NS
    if fleet.now < again:
        fleet.timer(craft, Timer.HOLD, again)
        return
    craft.reached[seq] = fleet.now
    _tell(fleet, craft)
    if slot.command != TO_ALT:  # verify_command returns before it says so
        craft.untold = seq
    if slot.command in _TOLD:
        fleet.text(craft, dialect.MAV_SEVERITY_INFO, f"Reached command #{seq}")
    fleet.note("event.item_reached", craft, {"seq": seq, "command": slot.command}, slot.causes)
    craft.flown = None
    craft.stage = Stage.NONE
    _advance(fleet, craft, seq + 1)
    _tell(fleet, craft)


def _tell(fleet: Fleet, craft: Craft) -> None:
    """Report what was reached, unless a DO item done in the same turn took its place.

    ArduPilot keeps one number until it is sent (`GCS::send_mission_item_reached_message`), and `AP_Mission::update`
    finishes the first DO item behind a navigation item in the turn that ends that.
    """
    if craft.untold:
        fleet.send(craft, dialect.MAVLink_mission_item_reached_message(craft.untold))
        craft.untold = 0


def _advance(fleet: Fleet, craft: Craft, seq: int) -> None:
    """Find the next navigation item and start it, with the DO items before it; else the mission is complete.

    The first DO item acts before the navigation item starts, the others after, as advance_current_nav_cmd has it.
    """
    do_items.drop(fleet, craft)
    first = jumps = 0

    def jumped(jump: int, made: int, times: int) -> None:
        nonlocal jumps
        jumps += 1
        if jumps <= _TEXTS:
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
            craft.ahead = _ahead(craft)
            fleet.timer(craft, Timer.HOLD)
            do_items.announce(fleet, craft, place)
            if not _begin(fleet, craft, slot):
                _reached(fleet, craft, slot)
            elif first and craft.flown is slot:
                _go_on(fleet, craft, first)
            auto_rtl.look(fleet, craft)
            return
        if not first:
            first = place
            if slot.command not in CONDITIONS:
                do_items.start(fleet, craft, place)
        seq = place + 1
    _complete(fleet, craft)


def _go_on(fleet: Fleet, craft: Craft, first: int) -> None:
    """The DO items from the first on, which has acted already unless it is a condition."""
    if craft.mission[first].command in CONDITIONS:
        do_items.run(fleet, craft, first)
    else:
        do_items.done(fleet, craft, first)
        _tell(fleet, craft)
        do_items.run(fleet, craft, first + 1)


def _begin(fleet: Fleet, craft: Craft, slot: Slot) -> bool:
    """Start a navigation item, with a look at the two behind it; `False` where it is over at once."""
    if slot.command in (LAND, TAKEOFF):
        craft.in_landing = slot.command == LAND
    following = next_navigation(craft, craft.current + 1)
    then = None if following is None else next_navigation(craft, following + 1)
    after = None if following is None else craft.mission[following]
    begun = flown_items.begin(fleet, craft, slot, after, None if then is None else craft.mission[then])
    pausing.stay(fleet, craft)
    return begun


def go_on(fleet: Fleet, craft: Craft) -> None:
    """The end of a pause: on to the item under way, along a leg from where it came to rest (ModeAuto::resume)."""
    if craft.paused and craft.flown is not None:
        craft.paused = False
        _begin(fleet, craft, craft.flown)


def _complete(fleet: Fleet, craft: Craft) -> None:
    """No item is left: hold in the air, disarm on the ground (ModeAuto::exit_mission)."""
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
