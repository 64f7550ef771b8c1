"""Motor commands of several aircraft at once: thrust, angle and rate controllers, and the mixer.

After AC_PosControl.cpp (`update_U_controller`), AC_AttitudeControl.cpp (`attitude_controller_run_quat`,
`update_ang_vel_target_from_att_error`), AC_AttitudeControl_Multi.cpp (`get_throttle_boosted`, `get_throttle_avg_max`)
and AC_PID.

Each aircraft has a lane: one number in each column of an array. `load_lane` copies an aircraft's records into its lane,
`run_controllers` computes all lanes by straight-line code at constant distances, which LLVM turns into vector
instructions, and `store_lane` copies the result back. + - * / and sqrt are exact to the last bit in every width of
vectors, so no number depends on the lane or on the other lanes. What would need a library function, large angles, is
computed lane by lane.

Motor mixer: from thrust and demands of roll, pitch and yaw to the commands of four motors. After
libraries/AP_Motors/AP_MotorsMatrix.cpp (`output_armed_stabilizing`). Without branches where it is computed for several
aircraft in vector registers: what is not needed is computed too, and not selected.
"""

from __future__ import annotations

import math
from typing import Any, Final

from skyrange.contracts.components import Floats
from skyrange.core import elementary
from skyrange.core.compiled import compiled, inlined
from skyrange.vehicle.builtin.control import attitude
from skyrange.vehicle.builtin.control.shaping import clamp

Four = tuple[float, float, float, float]
_YAW_HEADROOM = 0.2  # MOT_YAW_HEADROOM's 200 of 1000


@inlined
def thrust_to_actuator(expo: Four, spin: tuple[float, float], thrust: float) -> float:
    """Return the actuator command for a thrust 0…1: the inverse thrust curve, from MOT_SPIN_MIN to MOT_SPIN_MAX.

    `Thrust_Linearization::thrust_to_actuator`, without the compensation of the battery's voltage, which is off by
    default. `expo` are `GAINS`' expo, expo_a, expo_b, expo_c; `spin` are spin_min and spin_range.
    """
    thrust = clamp(thrust, 0.0, 1.0)
    root = math.sqrt(max(expo[1] + expo[2] * thrust, 0.0))  # the limit lets LLVM compute vectors of roots
    curved = (root if expo[0] > 0.0 else -root) - expo[3]
    linear = abs(expo[0]) <= 1e-6
    return spin[0] + spin[1] * (thrust if linear else curved)


@inlined
def _yaw_allowed(part: float, factor: float, best: float, yaw: float) -> float:
    """Return how much yaw a motor, whose yaw factor is ±½, allows on top of its part in roll and pitch."""
    # up to full thrust where yaw adds to it, else down to none
    return 1.0 + math.copysign(1.0, yaw * factor) * (1.0 - 2.0 * (best + part))


@inlined
def _fit_to_range(throttle: float, average: float, low: float, high: float) -> tuple[float, float, bool]:
    """Return (offset added to every motor, scale of the demands, whether thrust was reduced)."""
    span = high - low
    scale = 1.0 / span if span > 1.0 else 1.0
    scale = min(scale, -average / low) if average + low < 0.0 else scale
    high *= scale
    low *= scale
    more = throttle + low
    cut = scale < 1.0
    most = 1.0 + low - high
    above = more > most
    full = (throttle >= 1.0) | (cut & (more > 0.0)) | ((not cut) & (more >= 0.0) & above)
    more = 0.0 if cut | (more < 0.0) else (most if above else more)
    return more - low, scale, full


@inlined
def mix_motors(  # noqa: PLR0917
    roll_factor: Four, pitch_factor: Four, yaw_factor: Four,
    throttle: float, average: float, roll: float, pitch: float, yaw: float,
) -> tuple[bool, float, float, float, float]:  # fmt: skip
    """Return whether thrust was reduced, and the thrusts of four motors for a thrust 0…1 and three demands.

    Roll and pitch have priority, then some yaw, then thrust, which may be raised up to `average` for them. Positive
    roll lowers the right side, positive pitch lowers the nose, positive yaw turns left.
    """
    throttle = clamp(throttle, 0.0, 1.0)
    average = clamp(average, throttle, 1.0)
    a = roll * roll_factor[0] + pitch * pitch_factor[0]
    b = roll * roll_factor[1] + pitch * pitch_factor[1]
    c = roll * roll_factor[2] + pitch * pitch_factor[2]
    d = roll * roll_factor[3] + pitch * pitch_factor[3]
    best = min(0.5, average)
    span = 0.5 * (abs(roll) + abs(pitch) + abs(yaw))
    near = (span > min(best, throttle)) | (throttle + span >= 1.0)  # else far from every limit: nothing is reduced
    allowed = min(_yaw_allowed(a, yaw_factor[0], best, yaw), _yaw_allowed(b, yaw_factor[1], best, yaw))
    allowed = min(allowed, min(_yaw_allowed(c, yaw_factor[2], best, yaw), _yaw_allowed(d, yaw_factor[3], best, yaw)))
    allowed = max(min(allowed, 1.0), _YAW_HEADROOM)
    yaw = clamp(yaw, -allowed, allowed) if near else yaw
    a += yaw * yaw_factor[0]
    b += yaw * yaw_factor[1]
    c += yaw * yaw_factor[2]
    d += yaw * yaw_factor[3]
    base, scale, full = _fit_to_range(throttle, average, min(min(a, b), min(c, d)), max(max(a, b), max(c, d)))
    base = base if near else throttle
    scale = scale if near else 1.0
    return near & full, base + scale * a, base + scale * b, base + scale * c, base + scale * d


LANES: Final = 16
"""Aircraft that are computed together: two of the widest vector registers hold as many doubles."""
HELD, FOLLOWS_CLIMB, RATES_ONLY, ON_GROUND, COMING_DOWN = 1, 2, 4, 8, 16
"""Bits of what is asked for: to hold the attitude target; the throttle follows `climb_accel`, otherwise it is
`throttle`; to hold the target's rates, not the target; the target does not turn, and integrals of the rate controllers
stay 0; a descent close to the ground."""
_LEAN_COS_MIN = 0.5  # the angle boost's limit (AC_AttitudeControl_Multi::get_throttle_boosted)
_MIX_MAX = 0.5  # ATC_THR_MIX_MAX: share of hover thrust up to which attitude control may raise the thrust
_MIX_MIN = 0.1  # ATC_THR_MIX_MIN: the same on descent close to the ground

# where the lanes of each column begin; of several numbers, those of the first, the others follow
_SIZES: Final = {
    # gains
    "angle_p": 3, "angle_accel": 3, "angle_linear": 3, "yaw_error_max": 1, "rate_p": 3, "rate_i": 3, "rate_d": 2,
    "rate_imax": 3, "target_alpha": 3, "error_alpha": 3, "d_alpha": 2, "accel_alpha": 1, "accel_p": 1, "accel_i": 1,
    "accel_imax": 1, "hover": 1, "spin_min": 1, "spin_range": 1, "expo_a": 1, "expo_b": 1, "expo_c": 1, "expo": 1,
    "roll_factor": 4, "pitch_factor": 4, "yaw_factor": 4,
    # estimate
    "quat": 4, "rate": 3, "accel_z": 1,
    # flight
    "climb_accel": 1, "accel_err": 1, "throttle_i": 1, "throttle": 1, "limited": 1, "spool": 1, "target": 4,
    "target_rates": 3, "target_rate": 3, "rate_err": 3, "rate_d_state": 2, "rate_i_state": 3,
    # what is asked for: 1 or 0
    "holds_accel": 1, "turns": 1, "rates_only": 1, "on_ground": 1, "mix": 1,
    # between the two passes: the attitude error, its angles, whether it is small, the share of feed-forward
    "error": 4, "angles": 3, "tilt": 1, "small": 1, "forward": 1,
    "motors": 4,
}  # fmt: skip


def _begin(name: str) -> int:
    names = list(_SIZES)
    return LANES * sum(_SIZES[before] for before in names[: names.index(name)])


COLUMNS: Final = LANES * sum(_SIZES.values())
"""Numbers in the lanes' array."""
_ANGLE_P, _ANGLE_ACCEL, _ANGLE_LINEAR = _begin("angle_p"), _begin("angle_accel"), _begin("angle_linear")
_YAW_ERROR_MAX, _RATE_P, _RATE_I, _RATE_D = map(_begin, ("yaw_error_max", "rate_p", "rate_i", "rate_d"))
_RATE_IMAX, _TARGET_ALPHA, _ERROR_ALPHA = _begin("rate_imax"), _begin("target_alpha"), _begin("error_alpha")
_D_ALPHA, _ACCEL_ALPHA, _ACCEL_P, _ACCEL_I = map(_begin, ("d_alpha", "accel_alpha", "accel_p", "accel_i"))
_ACCEL_IMAX, _HOVER, _SPIN_MIN, _SPIN_RANGE = map(_begin, ("accel_imax", "hover", "spin_min", "spin_range"))
_EXPO_A, _EXPO_B, _EXPO_C, _EXPO = map(_begin, ("expo_a", "expo_b", "expo_c", "expo"))
_ROLL_FACTOR, _PITCH_FACTOR, _YAW_FACTOR = _begin("roll_factor"), _begin("pitch_factor"), _begin("yaw_factor")
_QUAT, _RATE, _ACCEL_Z = _begin("quat"), _begin("rate"), _begin("accel_z")
_CLIMB_ACCEL, _ACCEL_ERR, _THROTTLE_I = _begin("climb_accel"), _begin("accel_err"), _begin("throttle_i")
_THROTTLE, _LIMITED, _SPOOL = _begin("throttle"), _begin("limited"), _begin("spool")
_TARGET, _TARGET_RATES, _TARGET_RATE = _begin("target"), _begin("target_rates"), _begin("target_rate")
_RATE_ERR, _RATE_D_STATE, _RATE_I_STATE = _begin("rate_err"), _begin("rate_d_state"), _begin("rate_i_state")
_HOLDS_ACCEL, _TURNS, _RATES_ONLY = _begin("holds_accel"), _begin("turns"), _begin("rates_only")
_ON_GROUND, _MIX = _begin("on_ground"), _begin("mix")
_ERROR, _ANGLES, _TILT, _SMALL, _FORWARD = map(_begin, ("error", "angles", "tilt", "small", "forward"))
_MOTORS = _begin("motors")


@compiled
def load_gains(s: Floats, lane: int, g: Any) -> None:
    """Copy an aircraft's gains into its lane."""
    for axis in range(3):
        at = axis * LANES + lane
        s[_ANGLE_P + at] = g.angle_p[axis]
        s[_ANGLE_ACCEL + at] = g.angle_accel[axis]
        s[_ANGLE_LINEAR + at] = g.angle_linear[axis]
        s[_RATE_P + at] = g.rate_p[axis]
        s[_RATE_I + at] = g.rate_i[axis]
        s[_RATE_IMAX + at] = g.rate_imax[axis]
        s[_TARGET_ALPHA + at] = g.target_alpha[axis]
        s[_ERROR_ALPHA + at] = g.error_alpha[axis]
    for axis in range(2):
        s[_RATE_D + axis * LANES + lane] = g.rate_d[axis]
        s[_D_ALPHA + axis * LANES + lane] = g.d_alpha[axis]
    s[_YAW_ERROR_MAX + lane] = g.yaw_error_max
    s[_ACCEL_ALPHA + lane] = g.accel_alpha
    s[_ACCEL_P + lane] = g.accel_p
    s[_ACCEL_I + lane] = g.accel_i
    s[_ACCEL_IMAX + lane] = g.accel_imax
    s[_HOVER + lane] = g.throttle_hover
    s[_SPIN_MIN + lane] = g.spin_min
    s[_SPIN_RANGE + lane] = g.spin_range
    s[_EXPO_A + lane] = g.expo_a
    s[_EXPO_B + lane] = g.expo_b
    s[_EXPO_C + lane] = g.expo_c
    s[_EXPO + lane] = g.expo
    for motor in range(4):
        at = motor * LANES + lane
        s[_ROLL_FACTOR + at] = g.roll_factor[motor]
        s[_PITCH_FACTOR + at] = g.pitch_factor[motor]
        s[_YAW_FACTOR + at] = g.yaw_factor[motor]


@inlined
def load_lane(s: Floats, lane: int, e: Any, f: Any, todo: int) -> None:
    """Copy an aircraft's state into its lane; `todo` is what is asked for, a sum of the bits above."""
    s[_HOLDS_ACCEL + lane] = 1.0 if todo & FOLLOWS_CLIMB else 0.0
    s[_TURNS + lane] = 0.0 if todo & (ON_GROUND | RATES_ONLY) else 1.0
    s[_RATES_ONLY + lane] = 1.0 if todo & RATES_ONLY else 0.0
    s[_ON_GROUND + lane] = 1.0 if todo & ON_GROUND else 0.0
    s[_MIX + lane] = _MIX_MIN if todo & COMING_DOWN else _MIX_MAX
    s[_ACCEL_Z + lane] = e.accel[2]
    s[_CLIMB_ACCEL + lane] = f.climb_accel
    s[_ACCEL_ERR + lane] = f.accel_err
    s[_THROTTLE_I + lane] = f.throttle_i
    s[_THROTTLE + lane] = f.throttle
    s[_LIMITED + lane] = f.throttle_limited
    s[_SPOOL + lane] = f.spool_state
    for part in range(4):
        s[_QUAT + part * LANES + lane] = e.quat[part]
        s[_TARGET + part * LANES + lane] = f.att_target[part]
    for axis in range(3):
        at = axis * LANES + lane
        s[_RATE + at] = e.rate[axis]
        s[_TARGET_RATES + at] = f.att_target_rate[axis]
        s[_TARGET_RATE + at] = f.target_rate[axis]
        s[_RATE_ERR + at] = f.rate_err[axis]
        s[_RATE_I_STATE + at] = f.rate_i[axis]
    for axis in range(2):
        s[_RATE_D_STATE + axis * LANES + lane] = f.rate_d[axis]


@inlined
def store_lane(s: Floats, lane: int, f: Any, out: Floats, row: int) -> None:
    """Copy the result from a lane to an aircraft's records and to its motors, row `row` of `out`."""
    if s[_HOLDS_ACCEL + lane] == 1.0:
        f.accel_err = s[_ACCEL_ERR + lane]
        f.throttle_i = s[_THROTTLE_I + lane]
        f.throttle = s[_THROTTLE + lane]
    f.throttle_limited = 1 if s[_LIMITED + lane] == 1.0 else 0
    if s[_RATES_ONLY + lane] == 0.0:
        f.tilt_half2 = s[_TILT + lane]
    for part in range(4):
        f.att_target[part] = s[_TARGET + part * LANES + lane]
        out[row, part] = s[_MOTORS + part * LANES + lane]
    for axis in range(3):
        at = axis * LANES + lane
        f.target_rate[axis] = s[_TARGET_RATE + at]
        f.rate_err[axis] = s[_RATE_ERR + at]
        f.rate_i[axis] = s[_RATE_I_STATE + at] if s[_ON_GROUND + lane] == 0.0 else 0.0
    for axis in range(2):
        f.rate_d[axis] = s[_RATE_D_STATE + axis * LANES + lane]


@inlined
def _four(s: Floats, at: int) -> tuple[float, float, float, float]:
    """Return four numbers of one lane, which follow each other in columns from `at` on."""
    return s[at], s[at + LANES], s[at + 2 * LANES], s[at + 3 * LANES]


@compiled
def run_controllers(s: Floats, used: int, dt_s: float) -> None:
    """Compute the motor commands of the first `used` lanes."""
    _find_errors(s, dt_s)
    for lane in range(used):
        if s[_SMALL + lane] == 0.0 and s[_RATES_ONLY + lane] == 0.0:
            _find_large_error(s, lane)
    _command_motors(s)


@compiled
def _find_errors(s: Floats, dt_s: float) -> None:
    """Control the vertical acceleration, turn the targets, and find the errors of attitude, as if all were small."""
    for k in range(LANES):
        accel_err = s[_ACCEL_ERR + k]
        accel_err += (s[_CLIMB_ACCEL + k] - s[_ACCEL_Z + k] - accel_err) * s[_ACCEL_ALPHA + k]
        step = s[_ACCEL_I + k] * accel_err
        integral = s[_THROTTLE_I + k]
        throttle = s[_HOVER + k] + s[_ACCEL_P + k] * accel_err + integral
        held = ((throttle <= 0.0) & (step < 0.0)) | (((throttle >= 1.0) | (s[_LIMITED + k] == 1.0)) & (step > 0.0))
        moved = clamp(integral + step, -s[_ACCEL_IMAX + k], s[_ACCEL_IMAX + k])
        integral = integral if held else moved
        throttle = clamp(s[_HOVER + k] + s[_ACCEL_P + k] * accel_err + integral, 0.0, 1.0)
        s[_ACCEL_ERR + k] = accel_err
        s[_THROTTLE_I + k] = integral
        s[_THROTTLE + k] = throttle if s[_HOLDS_ACCEL + k] == 1.0 else s[_THROTTLE + k]

        tw, tx, ty, tz = _four(s, _TARGET + k)
        nw, nx, ny, nz = attitude.rotate_by_rates(
            tw, tx, ty, tz, s[_TARGET_RATES + k], s[_TARGET_RATES + LANES + k], s[_TARGET_RATES + 2 * LANES + k], dt_s
        )
        turns = s[_TURNS + k] == 1.0
        tw, tx, ty, tz = nw if turns else tw, nx if turns else tx, ny if turns else ty, nz if turns else tz
        s[_TARGET + k] = tw
        s[_TARGET + LANES + k] = tx
        s[_TARGET + 2 * LANES + k] = ty
        s[_TARGET + 3 * LANES + k] = tz
        w, x, y, z = attitude.relative_rotation(
            s[_QUAT + k], s[_QUAT + LANES + k], s[_QUAT + 2 * LANES + k], s[_QUAT + 3 * LANES + k], tw, tx, ty, tz
        )
        roll, pitch, yaw, tilt, small = attitude.small_rotation_angles(w, x, y, z)
        s[_ERROR + k] = w
        s[_ERROR + LANES + k] = x
        s[_ERROR + 2 * LANES + k] = y
        s[_ERROR + 3 * LANES + k] = z
        s[_ANGLES + k] = roll
        s[_ANGLES + LANES + k] = pitch
        s[_ANGLES + 2 * LANES + k] = yaw
        s[_TILT + k] = tilt
        s[_SMALL + k] = 1.0 if small & (abs(yaw) <= s[_YAW_ERROR_MAX + k]) else 0.0


@compiled
def _find_large_error(s: Floats, k: int) -> None:
    """Find the error of one lane whatever its size, and limit the lead of the target over a yaw that cannot follow."""
    w, x, y, z = _four(s, _ERROR + k)
    roll, pitch, yaw, tilt = attitude.thrust_heading_rotation_angles(w, x, y, z)
    most = s[_YAW_ERROR_MAX + k]
    if abs(yaw) > most:
        held = clamp(yaw, -most, most)
        sine = elementary.sin(0.5 * (held - yaw))
        cosine = elementary.cos(0.5 * (held - yaw))
        aw, ax, ay, az = _four(s, _TARGET + k)
        s[_TARGET + k] = aw * cosine - az * sine
        s[_TARGET + LANES + k] = ax * cosine + ay * sine
        s[_TARGET + 2 * LANES + k] = ay * cosine - ax * sine
        s[_TARGET + 3 * LANES + k] = az * cosine + aw * sine
        s[_ERROR + k] = w * cosine - z * sine
        s[_ERROR + LANES + k] = x * cosine + y * sine
        s[_ERROR + 2 * LANES + k] = y * cosine - x * sine
        s[_ERROR + 3 * LANES + k] = z * cosine + w * sine
        yaw = held
    s[_ANGLES + k] = roll
    s[_ANGLES + LANES + k] = pitch
    s[_ANGLES + 2 * LANES + k] = yaw
    s[_TILT + k] = tilt
    s[_FORWARD + k] = attitude.feed_forward_share(tilt)


@compiled
def _command_motors(s: Floats) -> None:
    """From the errors of attitude to body rates, from those to demands, and from these to motor commands."""
    for k in range(LANES):
        roll_rate = attitude.angle_to_rate(s[_ANGLES + k], s[_ANGLE_P + k], s[_ANGLE_LINEAR + k], s[_ANGLE_ACCEL + k])
        pitch_rate = attitude.angle_to_rate(
            s[_ANGLES + LANES + k], s[_ANGLE_P + LANES + k], s[_ANGLE_LINEAR + LANES + k], s[_ANGLE_ACCEL + LANES + k]
        )
        yaw_rate = attitude.angle_to_rate(
            s[_ANGLES + 2 * LANES + k],
            s[_ANGLE_P + 2 * LANES + k],
            s[_ANGLE_LINEAR + 2 * LANES + k],
            s[_ANGLE_ACCEL + 2 * LANES + k],
        )
        # the target's rates in the body frame
        w, x, y, z = _four(s, _ERROR + k)
        a = s[_TARGET_RATES + k]
        b = s[_TARGET_RATES + LANES + k]
        c = s[_TARGET_RATES + 2 * LANES + k]
        u = 2.0 * (y * c - z * b)
        v = 2.0 * (z * a - x * c)
        t = 2.0 * (x * b - y * a)
        ta, tb, tc = a + w * u + (y * t - z * v), b + w * v + (z * u - x * t), c + w * t + (x * v - y * u)
        tilt = s[_TILT + k]
        far = tilt > attitude.TILT_FAR2
        near = tilt <= attitude.TILT_NEAR2
        share = s[_FORWARD + k]
        turning = s[_RATE + 2 * LANES + k]
        yaw_mixed = turning * (1.0 - share) + (yaw_rate + tc) * share
        yaw_rate = turning if far else (yaw_rate + tc if near else yaw_mixed)
        roll_rate = roll_rate if far else (roll_rate + ta if near else roll_rate + ta * share)
        pitch_rate = pitch_rate if far else (pitch_rate + tb if near else pitch_rate + tb * share)
        rates_only = s[_RATES_ONLY + k] == 1.0
        roll_rate = a if rates_only else roll_rate
        pitch_rate = b if rates_only else pitch_rate
        yaw_rate = c if rates_only else yaw_rate

        # AC_PID::update_all
        for axis in range(3):
            at = axis * LANES + k
            wanted = roll_rate if axis == 0 else (pitch_rate if axis == 1 else yaw_rate)
            target = s[_TARGET_RATE + at] + (wanted - s[_TARGET_RATE + at]) * s[_TARGET_ALPHA + at]
            s[_TARGET_RATE + at] = target
            last = s[_RATE_ERR + at]
            error = last + (target - s[_RATE + at] - last) * s[_ERROR_ALPHA + at]
            s[_RATE_ERR + at] = error
            most = s[_RATE_IMAX + at]
            s[_RATE_I_STATE + at] = clamp(s[_RATE_I_STATE + at] + s[_RATE_I + at] * error * s[_SPOOL + k], -most, most)
            if axis < 2:
                s[_RATE_D_STATE + at] += (error - last - s[_RATE_D_STATE + at]) * s[_D_ALPHA + at]
        roll = s[_RATE_P + k] * s[_RATE_ERR + k] + s[_RATE_I_STATE + k] + s[_RATE_D + k] * s[_RATE_D_STATE + k]
        pitch = (
            s[_RATE_P + LANES + k] * s[_RATE_ERR + LANES + k]
            + s[_RATE_I_STATE + LANES + k]
            + s[_RATE_D + LANES + k] * s[_RATE_D_STATE + LANES + k]
        )
        yaw = s[_RATE_P + 2 * LANES + k] * s[_RATE_ERR + 2 * LANES + k] + s[_RATE_I_STATE + 2 * LANES + k]

        boost = 1.0 / max(attitude.cos_tilt(s[_QUAT + LANES + k], s[_QUAT + 2 * LANES + k]), _LEAN_COS_MIN)
        thrust = s[_THROTTLE + k] * boost
        mix = s[_MIX + k]
        average = max(thrust, s[_THROTTLE + k] * (1.0 - mix) + s[_HOVER + k] * mix)
        full, m0, m1, m2, m3 = mix_motors(
            _four(s, _ROLL_FACTOR + k), _four(s, _PITCH_FACTOR + k), _four(s, _YAW_FACTOR + k),
            thrust, average, clamp(roll, -1.0, 1.0), clamp(pitch, -1.0, 1.0), clamp(yaw, -1.0, 1.0),
        )  # fmt: skip
        s[_LIMITED + k] = 1.0 if full else 0.0
        expo = s[_EXPO + k], s[_EXPO_A + k], s[_EXPO_B + k], s[_EXPO_C + k]
        spin = s[_SPIN_MIN + k], s[_SPIN_RANGE + k]
        s[_MOTORS + k] = thrust_to_actuator(expo, spin, m0)
        s[_MOTORS + LANES + k] = thrust_to_actuator(expo, spin, m1)
        s[_MOTORS + 2 * LANES + k] = thrust_to_actuator(expo, spin, m2)
        s[_MOTORS + 3 * LANES + k] = thrust_to_actuator(expo, spin, m3)
