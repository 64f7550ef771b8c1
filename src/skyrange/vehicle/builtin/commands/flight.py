"""Flight commands: arming, take-off, modes, speed, yaw, targets, and the auxiliary functions of a mission.

After ArduCopter/GCS_MAVLink_Copter.cpp (`handle_command_int_packet` and what it calls) and
`handle_command_component_arm_disarm`, `_set_mode_common` of GCS_Common.cpp.

Auxiliary functions of DO_AUX_FUNCTION: changes of mode, fence and disarming by a mission. After
libraries/RC_Channel/RC_Channel.cpp `do_aux_function` and RC_Channel_Copter.cpp `do_aux_function_change_mode`. The low
position of a mode's function returns to the mode of the pilot's switch, which is not fitted here. ArduCopter runs the
function before it starts the navigation command that follows; here it runs after that, at the same time.
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin import fence
from skyrange.vehicle.builtin.arming.arming import MAGIC_FORCE_ARM, MAGIC_FORCE_ARM_DISARM, arm, disarm, start_takeoff
from skyrange.vehicle.builtin.commands.command import (
    ACCEPTED,
    DENIED,
    FAILED,
    UNSUPPORTED,
    Command,
    check_latlng,
    int32,
    is_relative,
    location_of,
    uint8,
    uint32,
)  # fmt: skip
from skyrange.vehicle.builtin.fleet import Causes, Fleet, MissionState, Vehicle
from skyrange.vehicle.builtin.flight_modes import guided
from skyrange.vehicle.builtin.guidance import auto_yaw
from skyrange.vehicle.builtin.locations import send_home
from skyrange.vehicle.builtin.mission import (
    do_commands,
    execution,
)
from skyrange.vehicle.builtin.mission.command_ids import (
    ARM_DISARM_FUNCTION,
    DISARM_FUNCTION,
    FENCE_FUNCTION,
    MODE_FUNCTIONS,
)
from skyrange.vehicle.builtin.mission.sequence import find_tag
from skyrange.vehicle.builtin.mode_change import enter_landing_sequence, set_mode
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.telemetry.schedule import Schedule

_SPEED_TYPE_END: Final = 4
_CHANGE_MODE: Final = int(mav.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
_MAX_ALT_M: Final = 1e5


def arm_disarm(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """COMPONENT_ARM_DISARM: 2989 in param2 forces arming, 21196 forces it and stops the motors in the air."""
    want, magic = command.params[0], command.params[1]
    if want == 1.0:
        if fleet.armed(vehicle):
            return ACCEPTED
        if not arm(fleet, vehicle, command.causes, checked=magic not in (MAGIC_FORCE_ARM, MAGIC_FORCE_ARM_DISARM)):
            return FAILED
        send_home(fleet, vehicle, command.causes)
        execution.update(fleet, vehicle)
        return ACCEPTED
    if want == 0.0:
        if fleet.armed(vehicle):
            if magic != MAGIC_FORCE_ARM_DISARM and not fleet.landed(vehicle):
                return FAILED
            disarm(fleet, vehicle, "forced" if magic == MAGIC_FORCE_ARM_DISARM else "command", command.causes)
        return ACCEPTED
    return UNSUPPORTED


def takeoff(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """NAV_TAKEOFF to a height above home: in GUIDED, armed, on the ground (Mode::do_user_takeoff)."""
    if command.frame != mav.MAV_FRAME_GLOBAL_RELATIVE_ALT:
        return DENIED
    # ArduCopter converts any value to integer centimetres; a value that is not a number is refused here
    if not abs(command.z) <= _MAX_ALT_M:
        return DENIED
    up = vehicle.home[2] + command.z
    if (
        vehicle.mode != Mode.GUIDED
        or not fleet.armed(vehicle)
        or not fleet.landed(vehicle)
        or up <= fleet.position(vehicle)[2]
    ):
        return FAILED
    vehicle.auto_armed = True
    vehicle.target_causes = command.causes
    fleet.set_default_limits(vehicle)
    start_takeoff(fleet, vehicle, up)
    return ACCEPTED


def _change_mode(fleet: Fleet, vehicle: Vehicle, mode: int, causes: Causes) -> int:
    return ACCEPTED if set_mode(fleet, vehicle, mode, "gcs_command", causes) else FAILED


def land(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """NAV_LAND: LAND at the present position, whatever place the command names."""
    return _change_mode(fleet, vehicle, Mode.LAND, command.causes)


def return_to_launch(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """NAV_RETURN_TO_LAUNCH: change to RTL."""
    return _change_mode(fleet, vehicle, Mode.RTL, command.causes)


def loiter_unlim(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """NAV_LOITER_UNLIM: change to LOITER."""
    return _change_mode(fleet, vehicle, Mode.LOITER, command.causes)


def handle_set_mode(fleet: Fleet, vehicle: Vehicle, base_mode: int, number: int, causes: Causes) -> int:
    """Change the mode (SET_MODE, DO_SET_MODE). There is no safety switch, which the base mode can also address."""
    if base_mode & mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
        return _change_mode(fleet, vehicle, number, causes)
    if base_mode == mav.MAV_MODE_FLAG_DECODE_POSITION_SAFETY and number in (0, 1):
        return ACCEPTED if number == 0 else FAILED
    return DENIED


def do_set_mode(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_SET_MODE. A value that is not a number is denied, where ArduCopter would read mode 0, STABILIZE.

    A base mode that does not fit into 32 bits is denied as well: ArduPilot on x86 reads 0, no custom mode.
    """
    base, number = command.params[0], command.params[1]
    if not (abs(base) < 2.0**31 and math.isfinite(number)):
        return DENIED
    return handle_set_mode(fleet, vehicle, uint8(base), uint32(number), command.causes)


def mission_start(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """MISSION_START: fly the whole mission; the aircraft may leave the ground."""
    if command.params[0] != 0.0 or command.params[1] != 0.0:
        return DENIED  # first and last items are not supported
    if not set_mode(fleet, vehicle, Mode.AUTO, "gcs_command", command.causes):
        return FAILED
    vehicle.mode_causes = command.causes
    vehicle.auto_armed = fleet.armed(vehicle)
    if vehicle.mission_state != MissionState.ACTIVE:
        execution.start_or_resume(fleet, vehicle)
    execution.update(fleet, vehicle)
    return ACCEPTED


def change_speed(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_CHANGE_SPEED: set the horizontal (0, 1), climb (2) or descent (3) speed until the mode changes."""
    kind, speed = int32(command.params[0]), command.params[1]
    if not speed > 0.0 or kind == _SPEED_TYPE_END:
        return DENIED
    if vehicle.mode not in (Mode.AUTO, Mode.GUIDED, Mode.RTL):
        return FAILED
    return ACCEPTED if do_commands.change_speed(fleet, vehicle, kind, speed) else FAILED


def condition_yaw(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """CONDITION_YAW: turn to an angle from north, or by an angle (param4 1), at most at the maximum rate.

    ArduCopter accepts it in any mode; it takes effect in modes that control the yaw themselves.
    """
    angle, rate, direction, relative = command.params
    if not 0.0 <= angle <= 360.0 or relative not in (0.0, 1.0):
        return FAILED
    if not (math.isfinite(rate) and math.isfinite(direction)):
        return FAILED
    sense = (direction > 0.0) - (direction < 0.0)
    auto_yaw.set_fixed_yaw(fleet, vehicle, angle, max(rate, 0.0), sense, relative=relative == 1.0)
    return ACCEPTED


def reposition(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_REPOSITION: fly to a place in GUIDED, or (bit 0 of param2) change to GUIDED for it. COMMAND_INT only."""
    may_change = bool(int32(command.params[1]) & _CHANGE_MODE)
    if vehicle.mode != Mode.GUIDED and not may_change:
        return DENIED
    if not check_latlng(command.x, command.y) or (command.x == 0 and command.y == 0):
        return DENIED
    goal = location_of(fleet, vehicle, command)
    if goal is None or (command.z == 0.0 and is_relative(command)):
        return DENIED
    if not fence.destination_within_fence(fleet, vehicle, goal):
        return FAILED  # before the mode is changed for it
    if vehicle.mode != Mode.GUIDED and not set_mode(fleet, vehicle, Mode.GUIDED, "gcs_command", command.causes):
        return FAILED
    return ACCEPTED if guided.set_destination(fleet, vehicle, goal, command.causes) else FAILED


def flight_termination(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_FLIGHTTERMINATION: stop the motors, also in flight."""
    if not command.params[0] > 0.5:
        return FAILED
    if fleet.armed(vehicle):
        disarm(fleet, vehicle, "termination", command.causes)
    return ACCEPTED


def set_mission_current(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_SET_MISSION_CURRENT; param2 1 clears the jump counters and continues after the end."""
    seq = uint32(command.params[0])
    if seq >= len(vehicle.mission):
        return DENIED
    again = command.params[1] == 1.0
    if again:
        execution.reset(vehicle)
    if not execution.set_current_cmd(fleet, vehicle, seq):
        return FAILED
    if again and vehicle.mode == Mode.AUTO and vehicle.mission_state != MissionState.ACTIVE:
        execution.start_or_resume(fleet, vehicle)
    command.after.append(mav.MAVLINK_MSG_ID_MISSION_CURRENT)
    return ACCEPTED


def jump_tag(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_JUMP_TAG: make the first item with a tag current (AP_Mission::jump_to_tag)."""
    tag = uint32(command.params[0])
    if tag > 0xFFFF:
        return DENIED
    seq = find_tag(vehicle, tag)
    return ACCEPTED if seq and execution.set_current_cmd(fleet, vehicle, seq) else FAILED


def land_start(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_LAND_START: fly the mission from its nearest landing sequence on."""
    return ACCEPTED if enter_landing_sequence(fleet, vehicle, "gcs_command", command.causes) else FAILED


def pause_continue(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_PAUSE_CONTINUE: pause on the way to a place, or continue (`handle_command_pause_continue`)."""
    what = uint8(command.params[0])
    if what > 1:
        return DENIED
    if what == 0 and execution.pause(fleet, vehicle):
        return ACCEPTED
    if what == 1 and vehicle.mode in (Mode.AUTO, Mode.GUIDED):
        if vehicle.mode == Mode.AUTO:
            execution.resume(fleet, vehicle)
        vehicle.paused = False
        return ACCEPTED
    fleet.send_text(
        vehicle, mav.MAV_SEVERITY_INFO, "Failed to pause" if what == 0 else "Failed to resume", command.causes
    )
    return FAILED


def motor_test(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, command: Command) -> int:
    """DO_MOTOR_TEST: refused in the air as by ArduCopter; unsupported on the ground, as in a build without it."""
    if fleet.landed(vehicle):
        return UNSUPPORTED
    fleet.send_text(vehicle, mav.MAV_SEVERITY_CRITICAL, "Motor Test: vehicle not landed", command.causes)
    return FAILED


_LOW: Final = 0
_HIGH: Final = 2
"""RC_Channel::AuxSwitchPos; a position beyond HIGH has no effect."""


def run_pending(fleet: Fleet) -> None:
    """Run the functions that missions have triggered in this tick, in the order of the fleet."""
    for vehicle in fleet.vehicles:
        while vehicle.aux_functions:
            _run(fleet, vehicle, *vehicle.aux_functions.pop(0))
    fleet.aux_pending = False


def _run(fleet: Fleet, vehicle: Vehicle, function: int, position: int, causes: Causes) -> None:
    if position > _HIGH:
        return
    if function in MODE_FUNCTIONS and position == _HIGH:
        set_mode(fleet, vehicle, MODE_FUNCTIONS[function], "aux_function", causes)
    elif function == FENCE_FUNCTION:
        fence.handle_do_fence_enable(fleet, vehicle, int(position == _HIGH), 0)
    elif (function, position) in ((DISARM_FUNCTION, _HIGH), (ARM_DISARM_FUNCTION, _LOW)) and fleet.armed(vehicle):
        disarm(fleet, vehicle, "aux_switch", causes)
