"""Pilot input: RC channels, and what the sticks request of the flight.

What the sticks request: lean angles, throttle, climb rate and yaw rate from the sticks, and the motion of LOITER. After
ArduCopter/mode.cpp (`get_pilot_desired_lean_angles_rad`, `get_pilot_desired_throttle`), Attitude.cpp
`get_pilot_desired_climb_rate`, AP_Math `rc_input_to_roll_pitch_rad`, and libraries/AC_WPNav/AC_Loiter.cpp.

RC channels: from microseconds per channel to the stick positions of the loop, and the throttle checks of arming. After
libraries/RC_Channel (`pwm_to_range_dz`, `norm_input_dz`) and AP_Arming_Copter.cpp `arm_checks`. Channels range from
1000 to 2000 µs and are reported at rest while nothing moves them: roll, pitch and yaw in the middle, throttle at the
bottom, switches off. A throttle that nothing moves counts as absent: it is at the bottom for STABILIZE, which reads it
in any case (`get_pilot_desired_throttle`), and requests no climb in other modes (`has_valid_input`,
RC_Channel_Copter.cpp).
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.control.gains import GRAVITY_MPS2
from skyrange.vehicle.builtin.control.shaping import clamp, limit_xy, sqrt_controller
from skyrange.vehicle.builtin.fleet import RC_CHANNELS, Fleet, Vehicle
from skyrange.vehicle.builtin.modes import MANUAL_THROTTLE, Mode

THROTTLE_MID = 0.484
"""RC_Channel::get_control_mid of a throttle from 1000 to 2000 µs with a dead zone of 30: 484 of 1000."""
_CDEG = math.pi / 18_000.0
_LEAN_MAX_RAD = math.radians(85.0)
_LEAN_LIMIT_RAD = math.radians(10.0)
_THROTTLE_ZERO_DEBOUNCE_S = 0.4  # THROTTLE_ZERO_DEBOUNCE_TIME_MS
_SPEED_MIN_MPS = 0.2  # LOITER_SPEED_MIN
MAX_LOITER_CORRECTION_MPS = 2.0
"""LOITER_VEL_CORRECTION_MAX."""


@compiled
def update_throttle_zero(f: Any, dt_s: float) -> bool:
    """Whether the throttle stick has been at the bottom for at least the debounce time (`set_throttle_zero_flag`)."""
    f.throttle_zero_s = 0.0 if f.sticks[3] > 0.0 else f.throttle_zero_s + dt_s
    return bool(f.throttle_zero_s >= _THROTTLE_ZERO_DEBOUNCE_S)


@compiled
def desired_lean_accel(e: Any, f: Any, angle_max: float, limit: float) -> tuple[float, float]:
    """Return the acceleration that the roll and pitch sticks request, m/s² (forward, left)."""
    angle_max = min(angle_max, _LEAN_MAX_RAD)
    forward = -elementary.tan(angle_max * f.sticks[1])
    left = -elementary.tan(angle_max * f.sticks[0])
    forward, left = limit_xy(forward, left, elementary.tan(clamp(limit, _LEAN_LIMIT_RAD, angle_max)))
    return GRAVITY_MPS2 * forward, GRAVITY_MPS2 * left


@compiled
def heading_to_local(e: Any, forward: float, left: float) -> tuple[float, float]:
    """Return (east, north) of a vector given along and across the heading."""
    c = elementary.cos(e.yaw)
    s = elementary.sin(e.yaw)
    return c * forward - s * left, s * forward + c * left


@compiled
def desired_yaw_rate(f: Any, p: Any) -> float:
    """Return the yaw rate that the stick requests, rad/s counter-clockwise: the stick to the right turns right."""
    x = f.sticks[2]
    expo = p.PILOT_Y_EXPO
    if expo < 0.95:  # input_expo
        x = (1.0 - expo) * x / (1.0 - expo * abs(x))
    return float(-math.radians(p.PILOT_Y_RATE) * x)


@compiled
def desired_throttle(f: Any, p: Any) -> float:
    """Return the thrust in STABILIZE: 0…1 of full, hovering at mid-stick."""
    stick = clamp(f.sticks[3], 0.0, 1.0)
    if stick < THROTTLE_MID:
        x = stick * 0.5 / THROTTLE_MID
    else:
        x = 0.5 + (stick - THROTTLE_MID) * 0.5 / (1.0 - THROTTLE_MID)
    expo = clamp(-(p.MOT_THST_HOVER - 0.5) / 0.375, -0.5, 1.0)
    return x * (1.0 - expo) + expo * x * x * x


@compiled
def desired_climb_rate(f: Any, p: Any) -> float:
    """Return the climb rate that the throttle stick requests, m/s: none around the middle."""
    stick = clamp(f.sticks[3], 0.0, 1.0)
    dead = 0.001 * clamp(p.THR_DZ, 0.0, 400.0)
    top = THROTTLE_MID + dead
    bottom = THROTTLE_MID - dead
    down = p.PILOT_SPEED_DN if p.PILOT_SPEED_DN > 0.0 else p.PILOT_SPEED_UP
    if stick < bottom:
        return float(0.01 * down * (stick - bottom) / bottom)
    if stick > top:
        return float(0.01 * p.PILOT_SPEED_UP * (stick - top) / (1.0 - top))
    return 0.0


@compiled
def loiter_angle_max(p: Any) -> float:
    """Return the largest lean angle in LOITER, rad (AC_Loiter::get_angle_max_rad)."""
    most = p.ANGLE_MAX * _CDEG
    return float(min(math.radians(p.LOIT_ANG_MAX), most) if p.LOIT_ANG_MAX > 0.0 else most * 2.0 / 3.0)


@compiled
def _lean_angles(forward: float, left: float) -> tuple[float, float]:
    """Return the lean angles (right side down, nose down) of an acceleration, rad."""
    nose_down = elementary.atan(forward / GRAVITY_MPS2)
    return elementary.atan(-elementary.cos(nose_down) * left / GRAVITY_MPS2), nose_down


@compiled
def update_loiter(e: Any, f: Any, p: Any, dt_s: float) -> None:
    """Move the reference of LOITER by one step.

    The sticks accelerate it, drag limits its speed, and it brakes when the sticks are released.
    """
    most = loiter_angle_max(p)
    forward, left = desired_lean_accel(e, f, most, p.ANGLE_MAX * _CDEG)
    roll, pitch = _lean_angles(forward, left)
    gain = 1.0 / max(p.ATC_INPUT_TC, 0.01)
    accel = p.ATC_ACCEL_R_MAX * _CDEG
    rate = sqrt_controller(roll - f.predicted_lean[0], gain, accel, dt_s)
    f.predicted_lean_rate[0] += clamp(rate - f.predicted_lean_rate[0], -accel * dt_s, accel * dt_s)
    accel = p.ATC_ACCEL_P_MAX * _CDEG
    rate = sqrt_controller(pitch - f.predicted_lean[1], gain, accel, dt_s)
    f.predicted_lean_rate[1] += clamp(rate - f.predicted_lean_rate[1], -accel * dt_s, accel * dt_s)
    f.predicted_lean[0] += f.predicted_lean_rate[0] * dt_s
    f.predicted_lean[1] += f.predicted_lean_rate[1] * dt_s
    soon_forward = GRAVITY_MPS2 * elementary.tan(f.predicted_lean[1])
    soon_left = -GRAVITY_MPS2 * elementary.tan(f.predicted_lean[0]) / elementary.cos(f.predicted_lean[1])
    soon_e, soon_n = heading_to_local(e, soon_forward, soon_left)
    acc_e, acc_n = heading_to_local(e, forward, left)
    speed_max = max(p.LOIT_SPEED * 0.01, _SPEED_MIN_MPS)
    vel_e = f.ref_vel[0] + soon_e * dt_s
    vel_n = f.ref_vel[1] + soon_n * dt_s
    speed = math.sqrt(vel_e * vel_e + vel_n * vel_n)
    f.brake_timer_s = f.brake_timer_s + dt_s if forward == 0.0 and left == 0.0 else 0.0
    if speed > 0.0:
        u = vel_e / speed
        v = vel_n / speed
        drag = GRAVITY_MPS2 * elementary.tan(most) * speed / speed_max
        brake = 0.0
        jerk = p.LOIT_BRK_JERK * 0.01
        if f.brake_timer_s > p.LOIT_BRK_DELAY:
            brake = clamp(sqrt_controller(speed, 0.5 * p.PSC_VELXY_P, jerk, dt_s), 0.0, p.LOIT_BRK_ACCEL * 0.01)
        f.brake_accel += clamp(brake - f.brake_accel, -jerk * dt_s, jerk * dt_s)
        acc_e -= u * f.brake_accel
        acc_n -= v * f.brake_accel
        speed = min(max(speed - (drag + f.brake_accel) * dt_s, 0.0), speed_max)
        vel_e = u * speed
        vel_n = v * speed
    f.ref_pos[0] += vel_e * dt_s
    f.ref_pos[1] += vel_n * dt_s
    f.ref_vel[0] = vel_e
    f.ref_vel[1] = vel_n
    f.ref_acc[0] = acc_e
    f.ref_acc[1] = acc_n
    # the reference stays within LOITER_POS_CORRECTION_MAX of the aircraft (AC_P_2D::update_all)
    off_e = f.ref_pos[0] - e.pos[0]
    off_n = f.ref_pos[1] - e.pos[1]
    off_e, off_n = limit_xy(off_e, off_n, MAX_LOITER_CORRECTION_MPS)
    f.ref_pos[0] = e.pos[0] + off_e
    f.ref_pos[1] = e.pos[1] + off_n


@compiled
def init_loiter_target(e: Any, f: Any) -> None:
    """Set the reference of LOITER to the aircraft's estimated motion and lean (AC_Loiter::init_target)."""
    for axis in range(2):
        f.ref_pos[axis] = e.pos[axis]
        f.ref_vel[axis] = e.vel[axis]
        f.ref_acc[axis] = 0.0
        f.predicted_lean_rate[axis] = 0.0
    f.predicted_lean[0] = e.roll
    f.predicted_lean[1] = e.pitch
    f.brake_accel = 0.0
    f.brake_timer_s = 0.0


MIN_US, MAX_US = 1000, 2000
_MID_US = 1500
_RESTING_US = (_MID_US, _MID_US, MIN_US, _MID_US, *[MIN_US] * (RC_CHANNELS - 4))
_DEAD_ZONES_US = (20, 20, 30, 20)
"""ArduCopter/radio.cpp `default_dead_zones`."""
_THROTTLE = 2
_ALT_HOLD_MODES = (Mode.ALT_HOLD, Mode.LOITER)


def update_sticks(fleet: Fleet, vehicle: Vehicle) -> None:
    """Update the channels and the stick positions of an aircraft."""
    values = [vehicle.rc_overrides.get(channel, (rest, 0))[0] for channel, rest in enumerate(_RESTING_US)]
    fleet.rc_channels[vehicle.row] = values
    stick = fleet.flight["sticks"][vehicle.row]
    for index, channel in enumerate((0, 1, 3)):
        stick[index] = _norm_input(values[channel], _DEAD_ZONES_US[channel])
    low = MIN_US + _DEAD_ZONES_US[_THROTTLE]
    thousandths = 1000 * (min(max(values[_THROTTLE], MIN_US), MAX_US) - low) // (MAX_US - low)
    stick[3] = max(thousandths, 0) / 1000.0
    if not _has_throttle_input(vehicle) and vehicle.mode in _ALT_HOLD_MODES:
        stick[3] = THROTTLE_MID  # no climb is requested (Copter::get_pilot_desired_climb_rate)


def _has_throttle_input(vehicle: Vehicle) -> bool:
    """Whether there is throttle input: without it ArduCopter's `has_valid_input` is false."""
    return _THROTTLE in vehicle.rc_overrides


def throttle_input(fleet: Fleet, vehicle: Vehicle) -> float:
    """Return the throttle stick, 0…1; at the bottom while nothing moves it."""
    return float(fleet.flight["sticks"][vehicle.row, 3]) if _has_throttle_input(vehicle) else 0.0


def _norm_input(us: int, dead_us: int) -> float:
    """Return -1…1 with a dead zone (RC_Channel::norm_input_dz)."""
    low, high = _MID_US - dead_us, _MID_US + dead_us
    if us > high:
        return min((us - high) / (MAX_US - high), 1.0)
    if us < low:
        return max((us - low) / (low - MIN_US), -1.0)
    return 0.0


def throttle_too_high(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether the throttle forbids arming (AP_Arming_Copter::arm_checks); GUIDED and AUTO ignore it."""
    if vehicle.mode in (Mode.GUIDED, Mode.AUTO):
        return False
    return throttle_above_mid(fleet, vehicle) or (
        vehicle.mode in MANUAL_THROTTLE and throttle_input(fleet, vehicle) > 0.0
    )


def throttle_above_mid(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether the throttle stick is above its middle."""
    row = vehicle.row
    return desired_climb_rate(fleet.flight[row], fleet.settings[row]) > 0.0


def manual_thrust(fleet: Fleet, vehicle: Vehicle) -> float:
    """Return the thrust that the throttle stick would give in STABILIZE."""
    if not _has_throttle_input(vehicle):
        return 0.0
    row = vehicle.row
    return float(desired_throttle(fleet.flight[row], fleet.settings[row]))
