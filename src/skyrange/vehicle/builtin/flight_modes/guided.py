"""GUIDED targets: SET_POSITION_TARGET_LOCAL_NED, SET_POSITION_TARGET_GLOBAL_INT and SET_ATTITUDE_TARGET.

After ArduCopter/GCS_MAVLink_Copter.cpp (`handle_message_set_…_target…`) and mode_guided.cpp. Positions, velocities,
accelerations and combinations of them, with a yaw or a yaw rate. An invalid combination stops the aircraft, as does a
number that is not finite, which ArduPilot checks in velocities only. All targets but positions expire after
GUID_TIMEOUT.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from skyrange.codec.mavlink import dialect
from skyrange.core import elementary
from skyrange.core.time import from_seconds
from skyrange.vehicle.builtin import fence, locations, loop
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Timer, Vehicle
from skyrange.vehicle.builtin.guidance import auto_yaw, wpnav
from skyrange.vehicle.builtin.layout import ControlMode
from skyrange.vehicle.builtin.modes import GUIDED_COMMANDS, Mode

_POS_IGNORE, _VEL_IGNORE, _ACC_IGNORE = 0b111, 0b111 << 3, 0b111 << 6
_FORCE, _YAW_IGNORE, _YAW_RATE_IGNORE = 1 << 9, 1 << 10, 1 << 11
_LOCAL_FRAMES = frozenset(
    (
        dialect.MAV_FRAME_LOCAL_NED,
        dialect.MAV_FRAME_LOCAL_OFFSET_NED,
        dialect.MAV_FRAME_BODY_NED,
        dialect.MAV_FRAME_BODY_OFFSET_NED,
    )
)
_BODY_FRAMES = frozenset((dialect.MAV_FRAME_BODY_NED, dialect.MAV_FRAME_BODY_OFFSET_NED))
_RATES_IGNORE, _THRUST_IGNORE, _ATTITUDE_IGNORE = 0b111, 1 << 6, 1 << 7
MAX_POSITION_M = 1e6
"""Larger than any sensible local position: such a target counts as invalid."""
_MAX_VELOCITY_MPS = 1e3
"""GCS_MAVLINK_Copter::sane_vel_or_acc_vector."""
_QUAT_NORM_TOLERANCE = 1e-3
_MAX_RATE_RADPS = 20.0
_OPTION_WPNAV = 1 << 6  # GUID_OPTIONS: positions are flown as waypoints
_TIMED_CONTROLS = frozenset((ControlMode.VELOCITY, ControlMode.POS_VEL_ACCEL, ControlMode.ACCEL, ControlMode.ATTITUDE))

Vector = tuple[float, float, float]
_ZERO: Vector = (0.0, 0.0, 0.0)


class _Target(NamedTuple):
    """The fields of a position target that are not ignored, in the local frame."""

    position: Vector | None
    velocity: Vector | None
    accel: Vector | None
    yaw: float | None
    yaw_rate: float | None
    relative: bool = False
    """Whether the yaw is measured from the present heading."""


def on_position_target_local(
    fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes
) -> None:
    """SET_POSITION_TARGET_LOCAL_NED: relative to the origin, the aircraft or its heading, by frame."""
    if not in_guided_mode(vehicle):
        return
    frame, mask = message.coordinate_frame, message.type_mask
    if frame not in _LOCAL_FRAMES:
        stop_and_hold(fleet, vehicle, causes)
        return
    position = velocity = accel = None
    if mask & _POS_IGNORE == 0:
        position = _to_enu(fleet, vehicle, frame, message.x, message.y, message.z)
        if frame != dialect.MAV_FRAME_LOCAL_NED:
            here = fleet.position(vehicle)
            position = (position[0] + here[0], position[1] + here[1], position[2] + here[2])
    if mask & _VEL_IGNORE == 0:
        velocity = _to_enu(fleet, vehicle, frame, message.vx, message.vy, message.vz)
    if mask & _ACC_IGNORE == 0:
        accel = _to_enu(fleet, vehicle, frame, message.afx, message.afy, message.afz)
    yaw = None if mask & _YAW_IGNORE else message.yaw
    rate = None if mask & _YAW_RATE_IGNORE else message.yaw_rate
    target = _Target(position, velocity, accel, yaw, rate, relative=frame in _BODY_FRAMES)
    _set_target(fleet, vehicle, target, causes, mask)


def on_position_target_global(
    fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes
) -> None:
    """SET_POSITION_TARGET_GLOBAL_INT: latitude, longitude, and altitude above sea level, home or terrain."""
    if not in_guided_mode(vehicle):
        return
    frame, mask = message.coordinate_frame, message.type_mask
    position = velocity = accel = None
    if mask & _POS_IGNORE == 0:
        position = locations.to_enu(fleet, vehicle, frame, message.lat_int, message.lon_int, message.alt)
        if position is None or (mask & _VEL_IGNORE == 0 and frame in locations.TERRAIN_FRAMES):
            stop_and_hold(fleet, vehicle, causes)
            return
    if mask & _VEL_IGNORE == 0:
        velocity = (message.vy, message.vx, -message.vz)
    if mask & _ACC_IGNORE == 0:
        accel = (message.afy, message.afx, -message.afz)
    yaw = None if mask & _YAW_IGNORE else message.yaw
    rate = None if mask & _YAW_RATE_IGNORE else message.yaw_rate
    if position is not None and velocity is not None and accel is not None:
        accel = _ZERO  # set_destination_posvel has no acceleration
    _set_target(fleet, vehicle, _Target(position, velocity, accel, yaw, rate), causes, mask)


def in_guided_mode(vehicle: Vehicle) -> bool:
    """Whether it obeys targets: in GUIDED, and in AUTO where the mission asks for them (`in_guided_mode`)."""
    item = vehicle.active_item
    takes_targets = item is not None and item.command in GUIDED_COMMANDS
    return vehicle.mode == Mode.GUIDED or (vehicle.mode == Mode.AUTO and takes_targets)


def _to_enu(fleet: Fleet, vehicle: Vehicle, frame: int, x: float, y: float, z: float) -> Vector:
    """Return a vector of the message as east, north, up."""
    if frame not in _BODY_FRAMES:
        return y, x, -z
    yaw = float(fleet.estimate["yaw"][vehicle.row])
    return x * elementary.cos(yaw) + y * elementary.sin(yaw), x * elementary.sin(yaw) - y * elementary.cos(yaw), -z


def is_sane(vector: Vector | None, most: float) -> bool:
    """Whether a vector, if there is one, is finite and within `most`."""
    return vector is None or all(abs(part) <= most for part in vector)


def _set_target(fleet: Fleet, vehicle: Vehicle, target: _Target, causes: Causes, mask: int) -> None:
    """Fly the requested combination of fields; stop where it is invalid or has a value that is not a number."""
    position, velocity, accel, yaw, yaw_rate, relative = target
    is_valid = (
        is_sane(position, MAX_POSITION_M) and is_sane(velocity, _MAX_VELOCITY_MPS) and is_sane(accel, _MAX_VELOCITY_MPS)
    )
    is_valid = is_valid and all(part is None or math.isfinite(part) for part in (yaw, yaw_rate))
    forced = bool(mask & _FORCE) and accel is not None
    alone = position is not None and velocity is None and accel is not None
    if not is_valid or forced or alone or (position is None and velocity is None and accel is None):
        stop_and_hold(fleet, vehicle, causes)
        return
    if (
        not fleet.armed(vehicle)
        or fleet.landed(vehicle)
        or not (position is None or fence.destination_within_fence(fleet, vehicle, position))
    ):
        return  # a place outside the fence changes nothing
    vehicle.target_causes = causes
    if position is not None and velocity is not None:
        _start_control(fleet, vehicle, ControlMode.POS_VEL_ACCEL)
        fleet.set_control(vehicle, ControlMode.POS_VEL_ACCEL, velocity)
        fleet.flight["target_pos"][vehicle.row] = position
    elif position is not None:
        start_position(fleet, vehicle, position)
    elif velocity is not None:
        _start_control(fleet, vehicle, ControlMode.VELOCITY)
        fleet.set_control(vehicle, ControlMode.VELOCITY, velocity)
    else:
        _start_control(fleet, vehicle, ControlMode.ACCEL)
        fleet.set_control(vehicle, ControlMode.ACCEL)
    if accel is not None:
        fleet.flight["target_acc"][vehicle.row] = accel
    _set_yaw(fleet, vehicle, yaw, yaw_rate, relative=relative)
    _restart_timeout(fleet, vehicle)


def _start_control(fleet: Fleet, vehicle: Vehicle, control: ControlMode) -> None:
    """Start another kind of target from the present state, at the limits of the WPNAV parameters."""
    if fleet.control(vehicle) != control:
        loop.init_reference(fleet.estimate, fleet.flight, vehicle.row)
        fleet.set_default_limits(vehicle)
        auto_yaw.set_mode_to_default(fleet, vehicle)


def set_destination(fleet: Fleet, vehicle: Vehicle, position: Vector, causes: Causes) -> bool:
    """Fly to a commanded place in GUIDED; `False` outside the fence (ModeGuided::set_destination)."""
    if not fence.destination_within_fence(fleet, vehicle, position):
        return False
    vehicle.target_causes = causes
    if fleet.armed(vehicle) and not fleet.landed(vehicle):
        fleet.set_timer(vehicle, Timer.GUIDED_TIMEOUT)
        start_position(fleet, vehicle, position)
        auto_yaw.set_mode_to_default(fleet, vehicle)
    return True


def start_position(fleet: Fleet, vehicle: Vehicle, position: Vector) -> None:
    """Fly to a place and hold it."""
    if int(fleet.param(vehicle, "GUID_OPTIONS")) & _OPTION_WPNAV:
        anew = fleet.control(vehicle) != ControlMode.LEG
        if anew:
            fleet.set_default_limits(vehicle)
        wpnav.start_leg(
            fleet.estimate, fleet.flight, fleet.legs, fleet.settings, vehicle.row, locations.as_array(position), anew
        )
        return
    _start_control(fleet, vehicle, ControlMode.POSITION)
    fleet.set_control(vehicle, ControlMode.POSITION)
    fleet.flight["target_pos"][vehicle.row] = position


def _set_yaw(fleet: Fleet, vehicle: Vehicle, yaw: float | None, rate: float | None, *, relative: bool) -> None:
    """Set the yaw target (ModeGuided::set_yaw_state_rad)."""
    if yaw is not None and relative:
        auto_yaw.set_fixed_yaw(fleet, vehicle, math.degrees(math.remainder(yaw, 2.0 * math.pi)), 0.0, 0, relative=True)
    elif yaw is not None:
        auto_yaw.set_yaw_angle_and_rate(fleet, vehicle, yaw, rate or 0.0)
    elif rate is not None:
        auto_yaw.set_rate(fleet, vehicle, rate)
    else:
        auto_yaw.set_mode_to_default(fleet, vehicle)


def stop_and_hold(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> None:
    """Stop and hold (ModeGuided::init)."""
    fleet.set_timer(vehicle, Timer.GUIDED_TIMEOUT)
    if not fleet.armed(vehicle) or fleet.landed(vehicle):
        return
    vehicle.target_causes = causes
    hold_velocity(fleet, vehicle)


def hold_velocity(fleet: Fleet, vehicle: Vehicle) -> None:
    """Hold at zero velocity from the present state, at the limits of the WPNAV parameters."""
    loop.init_reference(fleet.estimate, fleet.flight, vehicle.row)
    fleet.set_default_limits(vehicle)
    auto_yaw.set_mode_to_default(fleet, vehicle)
    fleet.set_control(vehicle, ControlMode.VELOCITY)


def on_attitude_target(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """SET_ATTITUDE_TARGET: an attitude or body rates, and a climb rate (thrust 0.5 is none, 0 and 1 the maximum)."""
    if not in_guided_mode(vehicle):
        return
    mask = message.type_mask
    rates = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
    quat = tuple(float(part) for part in message.q)
    turned = not mask & _ATTITUDE_IGNORE
    given = mask & _RATES_IGNORE
    bad = bool(mask & _THRUST_IGNORE) or given not in (0, _RATES_IGNORE) or not math.isfinite(message.thrust)
    bad = bad or (turned and not abs(math.fsum(part * part for part in quat) - 1.0) < _QUAT_NORM_TOLERANCE)
    bad = bad or (given == 0 and not all(math.isfinite(part) for part in rates))
    if bad:
        stop_and_hold(fleet, vehicle, causes)
        return
    thrust = min(max(message.thrust, 0.0), 1.0)
    limit = "WPNAV_SPEED_UP" if thrust > 0.5 else "WPNAV_SPEED_DN"
    climb_mps = (thrust - 0.5) * 2.0 * fleet.param(vehicle, limit) * 0.01
    if not fleet.armed(vehicle) or (fleet.landed(vehicle) and climb_mps <= 0.0):
        return
    vehicle.target_causes = causes
    row, flight = vehicle.row, fleet.flight
    if fleet.control(vehicle) != ControlMode.ATTITUDE:
        loop.init_reference(fleet.estimate, flight, row)
        fleet.set_default_limits(vehicle)
        if fleet.landed(vehicle):
            vehicle.auto_armed = True
            flight["throttle"][row] = 0.0
            loop.reset_controllers(flight, row)
            fleet.set_timer(vehicle, Timer.DISARM_DELAY)
            flight["flags"][row] = flight["handled_flags"][row] = 0
        fleet.set_control(vehicle, ControlMode.ATTITUDE)
    flight["guided_climb_rate"][row] = climb_mps
    flight["rates_only"][row] = int(not turned)
    forward, right, down = (
        (min(max(part, -_MAX_RATE_RADPS), _MAX_RATE_RADPS) for part in rates) if given == 0 else _ZERO
    )
    flight["guided_ang_vel"][row] = (forward, -right, -down)
    if turned:
        flight["guided_quat"][row] = frd_ned_to_flu_enu(*quat)
    _restart_timeout(fleet, vehicle)


def frd_ned_to_flu_enu(w: float, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Convert a quaternion from front-right-down, north-east-down to front-left-up, east-north-up, of length 1."""
    scale = math.sqrt(0.5 / (w * w + x * x + y * y + z * z))
    # half a turn about the north-east axis, the rotation, half a turn about the forward axis
    a, b, c, d = w + z, x + y, x - y, w - z
    return a * scale, b * scale, c * scale, d * scale


def quaternion_of_euler(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion of a yaw, then a pitch, then a roll, rad (Quaternion::from_euler)."""
    cr, sr = elementary.cos(0.5 * roll), elementary.sin(0.5 * roll)
    cp, sp = elementary.cos(0.5 * pitch), elementary.sin(0.5 * pitch)
    cy, sy = elementary.cos(0.5 * yaw), elementary.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _restart_timeout(fleet: Fleet, vehicle: Vehicle) -> None:
    fleet.set_timer(
        vehicle, Timer.GUIDED_TIMEOUT, fleet.now + from_seconds(max(fleet.param(vehicle, "GUID_TIMEOUT"), 0.1))
    )


def on_timeout(fleet: Fleet, vehicle: Vehicle) -> None:
    """Stop moving, level and stop turning when no new target came in time (mode_guided.cpp, `get_timeout_ms`)."""
    if not in_guided_mode(vehicle):
        return
    row, flight, control = vehicle.row, fleet.flight, fleet.control(vehicle)
    if control not in (*_TIMED_CONTROLS, ControlMode.POSITION):
        return
    auto_yaw.stop_yaw_rate(fleet, vehicle)
    if control == ControlMode.ATTITUDE:
        yaw = float(fleet.estimate["yaw"][row])
        flight["guided_quat"][row] = (elementary.cos(0.5 * yaw), 0.0, 0.0, elementary.sin(0.5 * yaw))
        flight["guided_ang_vel"][row] = 0.0
        flight["guided_climb_rate"][row] = 0.0
        flight["rates_only"][row] = 0
        return
    flight["target_vel"][row] = 0.0
    flight["target_acc"][row] = 0.0
    if control == ControlMode.ACCEL:
        fleet.set_control(vehicle, ControlMode.VELOCITY)
