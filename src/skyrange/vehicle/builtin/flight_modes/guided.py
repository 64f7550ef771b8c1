"""GUIDED targets: SET_POSITION_TARGET_LOCAL_NED, SET_POSITION_TARGET_GLOBAL_INT and SET_ATTITUDE_TARGET.

After ArduCopter/GCS_MAVLink_Copter.cpp (`handle_message_set_…_target…`) and mode_guided.cpp. Positions, velocities,
accelerations and combinations of them, with a yaw or a yaw rate. An invalid combination stops the aircraft, as does a
number that is not finite, which ArduPilot checks in velocities only. All targets but positions expire after
GUID_TIMEOUT.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.codec.mavlink import dialect
from skyrange.core.time import from_seconds
from skyrange.vehicle.builtin import facing, fence, loop, places, wpnav
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, Timer
from skyrange.vehicle.builtin.layout import Control
from skyrange.vehicle.builtin.modes import Mode

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
FAR_M = 1e6
"""Larger than any sensible local position: such a target counts as invalid."""
_MAX_VELOCITY_MPS = 1e3
"""GCS_MAVLINK_Copter::sane_vel_or_acc_vector."""
_QUAT_NORM_TOLERANCE = 1e-3
_MAX_RATE_RADPS = 20.0
_OPTION_WPNAV = 1 << 6  # GUID_OPTIONS: positions are flown as waypoints
_TIMED_CONTROLS = frozenset((Control.VELOCITY, Control.TRACK, Control.ACCEL, Control.ATTITUDE))

Vector = tuple[float, float, float]
_ZERO: Vector = (0.0, 0.0, 0.0)


def on_local(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """SET_POSITION_TARGET_LOCAL_NED: relative to the origin, the aircraft or its heading, by frame."""
    if craft.mode != Mode.GUIDED:
        return
    frame, mask = message.coordinate_frame, message.type_mask
    if frame not in _LOCAL_FRAMES:
        stop(fleet, craft, causes)
        return
    position = velocity = accel = None
    if mask & _POS_IGNORE == 0:
        position = _to_enu(fleet, craft, frame, message.x, message.y, message.z)
        if frame != dialect.MAV_FRAME_LOCAL_NED:
            here = fleet.position(craft)
            position = (position[0] + here[0], position[1] + here[1], position[2] + here[2])
    if mask & _VEL_IGNORE == 0:
        velocity = _to_enu(fleet, craft, frame, message.vx, message.vy, message.vz)
    if mask & _ACC_IGNORE == 0:
        accel = _to_enu(fleet, craft, frame, message.afx, message.afy, message.afz)
    yaw = None if mask & _YAW_IGNORE else message.yaw
    rate = None if mask & _YAW_RATE_IGNORE else message.yaw_rate
    _set_target(fleet, craft, position, velocity, accel, (yaw, rate, frame in _BODY_FRAMES), causes, mask)


def on_global(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """SET_POSITION_TARGET_GLOBAL_INT: latitude, longitude, and altitude above sea level, home or terrain."""
    if craft.mode != Mode.GUIDED:
        return
    frame, mask = message.coordinate_frame, message.type_mask
    position = velocity = accel = None
    if mask & _POS_IGNORE == 0:
        position = places.enu(fleet, craft, frame, message.lat_int, message.lon_int, message.alt)
        if position is None or (mask & _VEL_IGNORE == 0 and frame in places.TERRAIN_FRAMES):
            stop(fleet, craft, causes)
            return
    if mask & _VEL_IGNORE == 0:
        velocity = (message.vy, message.vx, -message.vz)
    if mask & _ACC_IGNORE == 0:
        accel = (message.afy, message.afx, -message.afz)
    yaw = None if mask & _YAW_IGNORE else message.yaw
    rate = None if mask & _YAW_RATE_IGNORE else message.yaw_rate
    if position is not None and velocity is not None and accel is not None:
        accel = _ZERO  # set_destination_posvel has no acceleration
    _set_target(fleet, craft, position, velocity, accel, (yaw, rate, False), causes, mask)


def _to_enu(fleet: Fleet, craft: Craft, frame: int, x: float, y: float, z: float) -> Vector:
    """Return a vector of the message as east, north, up."""
    if frame not in _BODY_FRAMES:
        return y, x, -z
    yaw = float(fleet.estimate["yaw"][craft.row])
    return x * math.cos(yaw) + y * math.sin(yaw), x * math.sin(yaw) - y * math.cos(yaw), -z


def sane(vector: Vector | None, most: float) -> bool:
    """Whether a vector, if there is one, is finite and within `most`."""
    return vector is None or all(abs(part) <= most for part in vector)


def _set_target(
    fleet: Fleet,
    craft: Craft,
    position: Vector | None,
    velocity: Vector | None,
    accel: Vector | None,
    yaw: tuple[float | None, float | None, bool],
    causes: Causes,
    mask: int,
) -> None:
    """Fly the requested combination of fields; stop where it is invalid or has a value that is not a number."""
    good = sane(position, FAR_M) and sane(velocity, _MAX_VELOCITY_MPS) and sane(accel, _MAX_VELOCITY_MPS)
    good = good and all(part is None or math.isfinite(part) for part in yaw[:2])
    forced = bool(mask & _FORCE) and accel is not None
    alone = position is not None and velocity is None and accel is not None
    if not good or forced or alone or (position is None and velocity is None and accel is None):
        stop(fleet, craft, causes)
        return
    if not fleet.armed(craft) or fleet.landed(craft) or not (position is None or fence.allows(fleet, craft, position)):
        return  # a place outside the fence changes nothing
    craft.target_causes = causes
    if position is not None and velocity is not None:
        _start_control(fleet, craft, Control.TRACK)
        fleet.fly(craft, Control.TRACK, velocity)
        fleet.flight["target_pos"][craft.row] = position
    elif position is not None:
        go_to(fleet, craft, position)
    elif velocity is not None:
        _start_control(fleet, craft, Control.VELOCITY)
        fleet.fly(craft, Control.VELOCITY, velocity)
    else:
        _start_control(fleet, craft, Control.ACCEL)
        fleet.fly(craft, Control.ACCEL)
    if accel is not None:
        fleet.flight["target_acc"][craft.row] = accel
    _set_yaw(fleet, craft, *yaw)
    _restart_timeout(fleet, craft)


def _start_control(fleet: Fleet, craft: Craft, control: Control) -> None:
    """Start another kind of target from the present state, at the limits of the WPNAV parameters."""
    if fleet.control(craft) != control:
        loop.hold(fleet.estimate, fleet.flight, craft.row)
        fleet.limits(craft)
        facing.default(fleet, craft)


def order(fleet: Fleet, craft: Craft, position: Vector, causes: Causes) -> bool:
    """Fly to a commanded place in GUIDED; `False` outside the fence (ModeGuided::set_destination)."""
    if not fence.allows(fleet, craft, position):
        return False
    craft.target_causes = causes
    if fleet.armed(craft) and not fleet.landed(craft):
        fleet.timer(craft, Timer.STALE)
        go_to(fleet, craft, position)
        facing.default(fleet, craft)
    return True


def go_to(fleet: Fleet, craft: Craft, position: Vector) -> None:
    """Fly to a place and hold it."""
    if int(fleet.param(craft, "GUID_OPTIONS")) & _OPTION_WPNAV:
        anew = fleet.control(craft) != Control.LEG
        if anew:
            fleet.limits(craft)
        wpnav.fly_to(fleet.estimate, fleet.flight, fleet.legs, fleet.settings, craft.row, places.array(position), anew)
        return
    _start_control(fleet, craft, Control.POSITION)
    fleet.fly(craft, Control.POSITION)
    fleet.flight["target_pos"][craft.row] = position


def _set_yaw(fleet: Fleet, craft: Craft, yaw: float | None, rate: float | None, relative: bool) -> None:
    """Set the yaw target (ModeGuided::set_yaw_state_rad)."""
    if yaw is not None and relative:
        facing.turn(fleet, craft, math.degrees(math.remainder(yaw, 2.0 * math.pi)), 0.0, 0, True)
    elif yaw is not None:
        facing.angle_and_rate(fleet, craft, yaw, rate or 0.0)
    elif rate is not None:
        facing.rate(fleet, craft, rate)
    else:
        facing.default(fleet, craft)


def stop(fleet: Fleet, craft: Craft, causes: Causes) -> None:
    """Stop and hold (ModeGuided::init)."""
    fleet.timer(craft, Timer.STALE)
    if not fleet.armed(craft) or fleet.landed(craft):
        return
    craft.target_causes = causes
    halt(fleet, craft)


def halt(fleet: Fleet, craft: Craft) -> None:
    """Hold at zero velocity from the present state, at the limits of the WPNAV parameters."""
    loop.hold(fleet.estimate, fleet.flight, craft.row)
    fleet.limits(craft)
    facing.default(fleet, craft)
    fleet.fly(craft, Control.VELOCITY)


def on_attitude(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """SET_ATTITUDE_TARGET: an attitude or body rates, and a climb rate (thrust 0.5 is none, 0 and 1 the maximum)."""
    if craft.mode != Mode.GUIDED:
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
        stop(fleet, craft, causes)
        return
    thrust = min(max(message.thrust, 0.0), 1.0)
    limit = "WPNAV_SPEED_UP" if thrust > 0.5 else "WPNAV_SPEED_DN"
    climb_mps = (thrust - 0.5) * 2.0 * fleet.param(craft, limit) * 0.01
    if not fleet.armed(craft) or (fleet.landed(craft) and climb_mps <= 0.0):
        return
    craft.target_causes = causes
    row, flight = craft.row, fleet.flight
    if fleet.control(craft) != Control.ATTITUDE:
        loop.hold(fleet.estimate, flight, row)
        fleet.limits(craft)
        if fleet.landed(craft):
            craft.ready = True
            flight["throttle"][row] = 0.0
            loop.rest(flight, row)
            fleet.timer(craft, Timer.IDLE)
            flight["flags"][row] = flight["seen"][row] = 0
        fleet.fly(craft, Control.ATTITUDE)
    flight["want_climb"][row] = climb_mps
    flight["rates_only"][row] = int(not turned)
    forward, right, down = (
        (min(max(part, -_MAX_RATE_RADPS), _MAX_RATE_RADPS) for part in rates) if given == 0 else _ZERO
    )
    flight["want_rate"][row] = (forward, -right, -down)
    if turned:
        flight["want_quat"][row] = flu_enu(*quat)
    _restart_timeout(fleet, craft)


def flu_enu(w: float, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Convert a quaternion from front-right-down, north-east-down to front-left-up, east-north-up, of length 1."""
    scale = math.sqrt(0.5 / (w * w + x * x + y * y + z * z))
    # half a turn about the north-east axis, the rotation, half a turn about the forward axis
    a, b, c, d = w + z, x + y, x - y, w - z
    return a * scale, b * scale, c * scale, d * scale


def _restart_timeout(fleet: Fleet, craft: Craft) -> None:
    fleet.timer(craft, Timer.STALE, fleet.now + from_seconds(max(fleet.param(craft, "GUID_TIMEOUT"), 0.1)))


def stale(fleet: Fleet, craft: Craft) -> None:
    """Stop moving, level and stop turning when no new target came in time (mode_guided.cpp, `get_timeout_ms`)."""
    if craft.mode != Mode.GUIDED:
        return
    row, flight, control = craft.row, fleet.flight, fleet.control(craft)
    if control not in (*_TIMED_CONTROLS, Control.POSITION):
        return
    facing.stop_turning(fleet, craft)
    if control == Control.ATTITUDE:
        yaw = float(fleet.estimate["yaw"][row])
        flight["want_quat"][row] = (math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw))
        flight["want_rate"][row] = 0.0
        flight["want_climb"][row] = 0.0
        flight["rates_only"][row] = 0
        return
    flight["target_vel"][row] = 0.0
    flight["target_acc"][row] = 0.0
    if control == Control.ACCEL:
        fleet.fly(craft, Control.VELOCITY)
