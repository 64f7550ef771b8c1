"""How is a mission flown? Which item is next, what each asks for, and when it is done.

After libraries/AP_Mission/AP_Mission.cpp (`update`, `advance_current_nav_cmd`, `get_next_cmd`, `set_current_cmd`) and
ArduCopter/mode_auto.cpp (`do_…`, `verify_…`, `exit_mission`). Navigation items take time and are flown one after
another; DO items between them act at once.
"""

from __future__ import annotations

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.core.time import from_seconds
from skyrange.vehicle.builtin import loop, returning
from skyrange.vehicle.builtin.arming import disarm, take_off
from skyrange.vehicle.builtin.fleet import Craft, Fleet, MissionState, Slot, Stage, Timer
from skyrange.vehicle.builtin.layout import Control, Flag
from skyrange.vehicle.builtin.modes import Mode

WAYPOINT = dialect.MAV_CMD_NAV_WAYPOINT
RTL = dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH
LAND = dialect.MAV_CMD_NAV_LAND
TAKEOFF = dialect.MAV_CMD_NAV_TAKEOFF
JUMP = dialect.MAV_CMD_DO_JUMP
SPEED = dialect.MAV_CMD_DO_CHANGE_SPEED

NAVIGATION = frozenset((WAYPOINT, RTL, LAND, TAKEOFF))
RELATIVE_FRAMES = frozenset((dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT))

_MAX_JUMPS = 64  # get_next_cmd
_MAX_ITEMS = 255  # advance_current_nav_cmd: a loop of jumps and DO items ends the mission
_SPEED_MIN_MPS = 0.1  # AC_WPNav.cpp WPNAV_WP_SPEED_MIN_CMS
_SPEED_MAX_MPS = 100.0  # beyond any multirotor: keeps an absurd request finite
_FAST_FOLLOWERS = frozenset((WAYPOINT,))


def starts_with_takeoff(craft: Craft) -> bool:
    """Whether the first navigation item to be flown is a take-off (AP_Mission::starts_with_takeoff_cmd)."""
    seq = _next_navigation(craft, craft.current if craft.flown is not None and craft.current else 1)
    return seq is not None and craft.mission[seq].command == TAKEOFF


def start_or_resume(fleet: Fleet, craft: Craft) -> None:
    """AUTO was entered: begin anew after the end or where MIS_RESTART says so, else go on with the item left."""
    if craft.mission_state == MissionState.COMPLETE or fleet.param(craft, "MIS_RESTART") == 1:
        reset(craft)
    craft.mission_state = MissionState.ACTIVE
    craft.flown = None
    update(fleet, craft)


def reset(craft: Craft) -> None:
    """Back to the first item, jump counters cleared."""
    craft.current = 0
    craft.flown = None
    craft.jumps.clear()


def stop(craft: Craft) -> None:
    """AUTO is left: the item under way is kept for the way back."""
    if craft.mission_state == MissionState.ACTIVE:
        craft.mission_state = MissionState.NOT_STARTED
    craft.stage = Stage.NONE


def update(fleet: Fleet, craft: Craft) -> None:
    """Start the item that is due, if the mission runs, the motors are armed and none has been started."""
    if craft.mode == Mode.AUTO and craft.mission_state == MissionState.ACTIVE and fleet.armed(craft):
        if craft.flown is None:
            _advance(fleet, craft, craft.current or 1)
        elif craft.ready and craft.flown.command == TAKEOFF and fleet.control(craft) == Control.IDLE:
            _begin(fleet, craft, craft.flown, corner=False)


def set_current(fleet: Fleet, craft: Craft, seq: int) -> bool:
    """Make an item current, as MISSION_SET_CURRENT asks; 0 restarts. `False` where there is no such item."""
    if seq >= len(craft.mission) or len(craft.mission) <= 1:
        return False
    if seq == 0 or craft.mission_state == MissionState.COMPLETE:
        craft.jumps.clear()
    seq = max(seq, 1)
    craft.flown = None
    fleet.timer(craft, Timer.HOLD)
    if craft.mission_state == MissionState.ACTIVE and craft.mode == Mode.AUTO and fleet.armed(craft):
        _advance(fleet, craft, seq)
        return craft.flown is not None
    found = _next_navigation(craft, seq)
    if found is None:
        return False
    craft.current = seq
    if craft.mission_state != MissionState.ACTIVE:
        craft.mission_state = MissionState.NOT_STARTED
    return True


def changed(fleet: Fleet, craft: Craft) -> None:
    """The mission was rewritten: a waypoint under way is started anew, an item that is gone is not current."""
    if craft.current >= len(craft.mission):
        reset(craft)
        if craft.mode == Mode.AUTO and craft.mission_state == MissionState.ACTIVE and not craft.sees_mission:
            _complete(fleet, craft)
            return
    if craft.mode == Mode.AUTO and craft.flown is not None and craft.flown.command == WAYPOINT:
        fleet.timer(craft, Timer.HOLD)
        craft.flown = None
        _advance(fleet, craft, craft.current)


def change_speed(fleet: Fleet, craft: Craft, kind: int, speed_mps: float) -> bool:
    """Set the level (0, 1), climb (2) or descent (3) speed; `False` for other kinds. Lasts until the mode changes."""
    name = {0: "speed_xy", 1: "speed_xy", 2: "speed_up", 3: "speed_down"}.get(kind)
    if name is None:
        return False
    if speed_mps >= _SPEED_MIN_MPS:
        fleet.flight[name][craft.row] = min(speed_mps, _SPEED_MAX_MPS)
        fleet.flight["replan"][craft.row] = 1
    return True


def goal_of(fleet: Fleet, craft: Craft, slot: Slot, default: tuple[float, float, float]) -> tuple[float, float, float]:
    """Where an item lies, ENU metres; latitude and longitude both 0, or altitude 0, mean `default`'s."""
    east, north, up = default
    if slot.x != 0 or slot.y != 0:
        east, north = fleet.origin.enu_of(slot.x * 1e-7, slot.y * 1e-7)
    if slot.z != 0.0:
        up = slot.z + (craft.home[2] if slot.frame in RELATIVE_FRAMES else -fleet.origin.alt_msl_m)
    return east, north, up


def on_flag(fleet: Fleet, craft: Craft, flag: Flag) -> None:
    """The loop reports an arrival, a climb done or a landing while AUTO flies an item."""
    slot = craft.flown
    if slot is None:
        return
    if flag is Flag.CLIMBED and slot.command == TAKEOFF:
        _reached(fleet, craft, slot, corner=False)
    elif flag is Flag.ARRIVED:
        if slot.command == WAYPOINT:
            if slot.param1 > 0.0:
                fleet.timer(craft, Timer.HOLD, fleet.now + from_seconds(float(int(slot.param1))))
            else:
                _reached(fleet, craft, slot, corner=bool(fleet.flight["fast"][craft.row]))
        elif slot.command == LAND:
            craft.stage = Stage.LAND
            fleet.fly(craft, Control.LAND)
        elif slot.command == RTL:
            returning.arrived(fleet, craft)
            if craft.stage == Stage.DESCEND:
                _reached(fleet, craft, slot, corner=False)


def waited(fleet: Fleet, craft: Craft) -> None:
    """A wait is over: at a waypoint, or above home."""
    slot = craft.flown
    if slot is None:
        return
    if slot.command == RTL:
        returning.waited(fleet, craft)
    elif slot.command == WAYPOINT:
        _reached(fleet, craft, slot, corner=False)


def settled(fleet: Fleet, craft: Craft) -> None:
    """It stands on the ground with idle motors: the landing item ends the mission unless a take-off follows."""
    slot = craft.flown
    if slot is None:
        return
    following = _next_navigation(craft, craft.current + 1)
    if slot.command == RTL or (following is not None and craft.mission[following].command == TAKEOFF):
        _reached(fleet, craft, slot, corner=False)
    else:
        disarm(fleet, craft, "landed", slot.causes)


def _reached(fleet: Fleet, craft: Craft, slot: Slot, corner: bool) -> None:
    """Say that the current item is done, and start the next."""
    seq = craft.current
    fleet.send(craft, dialect.MAVLink_mission_item_reached_message(seq))
    if slot.command == WAYPOINT:
        fleet.text(craft, dialect.MAV_SEVERITY_INFO, f"Reached command #{seq}")
    fleet.note("event.item_reached", craft, {"seq": seq, "command": slot.command}, slot.causes)
    craft.flown = None
    craft.stage = Stage.NONE
    _advance(fleet, craft, seq + 1, corner)


def _advance(fleet: Fleet, craft: Craft, seq: int, corner: bool = False) -> None:
    """Act on DO items from `seq` on until a navigation item is found and started; else the mission is complete."""
    place: int | None = seq
    for _ in range(_MAX_ITEMS):
        place = _resolve(craft, place, count=True)
        if place is None:
            break
        slot = craft.mission[place]
        if slot.command in NAVIGATION:
            craft.current = place
            craft.flown = slot
            _begin(fleet, craft, slot, corner)
            return
        if slot.command == SPEED and slot.param2 > 0.0:
            change_speed(fleet, craft, int(slot.param1), slot.param2)
        place += 1
    _complete(fleet, craft)


def _resolve(craft: Craft, seq: int | None, count: bool) -> int | None:
    """The first item from `seq` on that is no jump, following jumps; counts them as made where `count`."""
    if seq is None:
        return None
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
            made[seq] = made.get(seq, 0) + 1 if times >= 0 else 0
            seq = target
        else:
            made.pop(seq, None)
            seq += 1
    return None


def _next_navigation(craft: Craft, seq: int) -> int | None:
    """The navigation item that would be flown from `seq` on; looks without counting jumps."""
    for _ in range(_MAX_ITEMS):
        found = _resolve(craft, seq, count=False)
        if found is None or craft.mission[found].command in NAVIGATION:
            return found
        seq = found + 1
    return None


def _begin(fleet: Fleet, craft: Craft, slot: Slot, corner: bool) -> None:
    """Start a navigation item. On the ground only a take-off moves the craft, and only when it is ready."""
    landed = fleet.landed(craft)
    craft.target_causes = slot.causes or craft.mode_causes
    if slot.command == TAKEOFF:
        here = fleet.position(craft)
        up = max(goal_of(fleet, craft, slot, here)[2], here[2] + (1.0 if landed else 0.0))
        if not landed or craft.ready:
            take_off(fleet, craft, up)
        return
    if landed:
        return
    if slot.command == WAYPOINT:
        end = tuple(fleet.flight["target_pos"][craft.row].tolist()) if corner else _from(fleet, craft)
        goal = goal_of(fleet, craft, slot, (end[0], end[1], end[2]))
        following = None if slot.param1 > 0.0 else _next_navigation(craft, craft.current + 1)
        fast = following is not None and craft.mission[following].command in _FAST_FOLLOWERS
        _leg(fleet, craft, goal, fast, corner)
    elif slot.command == LAND:
        if slot.x == 0 and slot.y == 0:
            craft.stage = Stage.LAND
            fleet.fly(craft, Control.LAND)
        else:
            craft.stage = Stage.TRANSIT
            stop_at = returning.stopping_point(fleet, craft)
            east, north, _ = goal_of(fleet, craft, slot, stop_at)
            _leg(fleet, craft, (east, north, stop_at[2]), False, False)
    elif slot.command == RTL:
        returning.start(fleet, craft)


def _from(fleet: Fleet, craft: Craft) -> tuple[float, float, float]:
    """What a waypoint without a position means: the end of the leg just flown, or where the craft comes to rest."""
    flight, row = fleet.flight, craft.row
    if flight["control"][row] in (Control.LEG, Control.TAKEOFF) and flight["flags"][row] & (
        Flag.ARRIVED | Flag.CLIMBED
    ):
        east, north, up = flight["ref_pos"][row].tolist()
        return east, north, float(flight["target_pos"][row, 2]) if flight["control"][row] == Control.TAKEOFF else up
    return returning.stopping_point(fleet, craft)


def _leg(fleet: Fleet, craft: Craft, goal: tuple[float, float, float], fast: bool, corner: bool) -> None:
    loop.set_leg(fleet.flight, fleet.settings, craft.row, np.array(goal), fast, corner, True)


def _complete(fleet: Fleet, craft: Craft) -> None:
    """No item is left: hold in the air, disarm on the ground (ModeAuto::exit_mission)."""
    craft.mission_state = MissionState.COMPLETE
    craft.flown = None
    if fleet.landed(craft):
        if fleet.armed(craft):
            disarm(fleet, craft, "mission_exit", craft.mode_causes)
    else:
        fleet.fly(craft, Control.VELOCITY)
