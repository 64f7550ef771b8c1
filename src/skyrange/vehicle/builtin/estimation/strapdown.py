"""Strapdown inertial navigation: gyroscopes and accelerometers, integrated from tick to tick.

EKF3's UpdateStrapdownEquationsNED and calcOutputStates: attitude by the mean rate, velocity by the specific force in
the attitude before it, position by the mean of two velocities. The output follows the state with the corrections
applied over EK3_TAU_OUTPUT, so that no measurement makes the controllers jump; attitude is output as it is.
"""

from __future__ import annotations

import math
from typing import Any, Final

from skyrange.contracts.components import Floats
from skyrange.core import elementary
from skyrange.core.compiled import compiled, inlined
from skyrange.vehicle.builtin.control.gains import GRAVITY_MPS2
from skyrange.vehicle.builtin.control.shaping import clamp
from skyrange.vehicle.builtin.estimation.state import (
    ACCEL_MAX_MPS2,
    GYRO_MAX_RADPS,
    HEIGHT_MAX_M,
    HEIGHT_MIN_M,
    POS_LIMIT_M,
    VEL_LIMIT_MPS,
    Aiding,
)
from skyrange.vehicle.builtin.layout import Records

_NONE = int(Aiding.NONE)
_SERIES_LIMIT = 0.05  # tangent below which an angle is computed by a series
_ACCEL_UNAIDED_MPS2 = 5.0  # UpdateStrapdownEquationsNED: manoeuvres without aiding

LANES: Final = 16
# where the lanes of each column begin: readings, state, corrections that the output does not contain yet
(
    _GX, _GY, _GZ, _FX, _FY, _FZ, _OLD_FX, _OLD_FY, _OLD_FZ, _RX, _RY, _RZ, _BX, _BY, _BZ, _ACCEL_BIAS, _UNAIDED,
    _QW, _QX, _QY, _QZ, _VX, _VY, _VZ, _PX, _PY, _PZ, _PENDING_VX, _PENDING_VY, _PENDING_VZ, _PENDING_PX, _PENDING_PY,
    _PENDING_PZ, _YAW_COS, _YAW_SIN, _YAW_REF, _AX, _AY, _AZ, _OUT_VX, _OUT_VY, _OUT_VZ, _OUT_PX, _OUT_PY, _OUT_PZ,
    _YAW, _YAW_NEAR, COLUMNS,
) = range(0, 48 * LANES, LANES)  # fmt: skip


@inlined
def valid_reading(value: float, before: float, most: float) -> float:
    """Return a plausible sensor value: the last one instead of a NaN, full scale instead of more."""
    limited = clamp(value, -most, most)
    return before if value != value else limited


@inlined
def yaw_near(  # noqa: PLR0917
    reference: float, cosine: float, sine: float, w: float, x: float, y: float, z: float
) -> tuple[float, bool]:
    """Return the yaw of an attitude by its difference to a reference direction, and whether it is near enough for that.

    Small changes from a known angle by a series, exact to 1e-12: atan2 in every tick would cost as much as the rest.
    """
    ahead_now = 1 - 2 * (y * y + z * z)
    across_now = 2 * (w * z + x * y)
    across = cosine * across_now - sine * ahead_now
    ahead = cosine * ahead_now + sine * across_now
    t = across / ahead
    t2 = t * t
    yaw = reference + t * (1.0 - t2 * (1.0 / 3.0 - t2 * (0.2 - t2 / 7.0)))
    turned = yaw - 2.0 * math.pi if yaw >= math.pi else yaw
    turned = yaw + 2.0 * math.pi if yaw < -math.pi else turned
    return turned, abs(across) < _SERIES_LIMIT * ahead


@compiled
def run_strapdown(  # noqa: PLR0917
    lanes: Floats, first: int, used: int, gyro: Floats, accel: Floats, dt_s: float, shown: bool,  # noqa: FBT001
    estimate: Records, filters: Records,
) -> None:  # fmt: skip
    """Advance the state of `used` rows from `first` on by a tick, with everything of the estimate that changes then.

    `lanes` is an array of `COLUMNS` numbers, `gyro` and `accel` (rows, 3) are the readings. With `shown`,
    position, velocity and yaw of the output are updated too.
    """
    for lane in range(used):
        row = first + lane
        _load_lane(lanes, lane, row, gyro, accel, estimate[row], filters[row])
    _integrate_lanes(lanes, dt_s)
    for lane in range(used):
        row = first + lane
        _store_lane(lanes, lane, shown, estimate[row], filters[row])


@inlined
def _load_lane(s: Floats, lane: int, row: int, gyro: Floats, accel: Floats, e: Any, k: Any) -> None:  # noqa: PLR0917
    for axis in range(3):
        at = axis * LANES + lane
        s[_GX + at] = gyro[row, axis]
        s[_FX + at] = accel[row, axis]
        s[_OLD_FX + at] = k.force[axis]
        s[_RX + at] = k.rate[axis]
        s[_BX + at] = k.gyro_bias[axis]
        s[_VX + at] = k.vel[axis]
        s[_PX + at] = k.pos[axis]
        s[_PENDING_VX + at] = k.pending_vel[axis]
        s[_PENDING_PX + at] = k.pending_pos[axis]
    for part in range(4):
        s[_QW + part * LANES + lane] = e.quat[part]
    s[_ACCEL_BIAS + lane] = k.accel_bias
    s[_UNAIDED + lane] = 1.0 if k.aiding == _NONE else 0.0
    s[_YAW_COS + lane] = k.yaw_cos
    s[_YAW_SIN + lane] = k.yaw_sin
    s[_YAW_REF + lane] = k.yaw_ref


@inlined
def _store_lane(s: Floats, lane: int, shown: bool, e: Any, k: Any) -> None:  # noqa: FBT001
    for axis in range(3):
        at = axis * LANES + lane
        k.force[axis] = s[_FX + at]
        k.rate[axis] = s[_RX + at]
        k.vel[axis] = s[_VX + at]
        k.pos[axis] = s[_PX + at]
        e.rate[axis] = s[_RX + at]
        e.accel[axis] = s[_AX + at]
    for part in range(4):
        e.quat[part] = s[_QW + part * LANES + lane]
    if not shown:
        return
    for axis in range(3):
        e.vel[axis] = s[_OUT_VX + axis * LANES + lane]
        e.pos[axis] = s[_OUT_PX + axis * LANES + lane]
    if s[_YAW_NEAR + lane] == 1.0:
        e.yaw = s[_YAW + lane]
    else:
        _set_yaw_reference(e, k)


@compiled
def _integrate_lanes(s: Floats, dt_s: float) -> None:
    """Advance all lanes by a tick: straight-line code, which LLVM turns into vector instructions (`motor_control`)."""
    for k in range(LANES):
        w, x, y, z = s[_QW + k], s[_QX + k], s[_QY + k], s[_QZ + k]
        a = valid_reading(s[_FX + k], s[_OLD_FX + k], ACCEL_MAX_MPS2)
        b = valid_reading(s[_FY + k], s[_OLD_FY + k], ACCEL_MAX_MPS2)
        c = valid_reading(s[_FZ + k], s[_OLD_FZ + k], ACCEL_MAX_MPS2)
        s[_FX + k], s[_FY + k], s[_FZ + k] = a, b, c
        east = (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c
        north = 2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c
        up = 2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c
        up = up - GRAVITY_MPS2 - s[_ACCEL_BIAS + k]
        s[_AX + k], s[_AY + k], s[_AZ + k] = east, north, up
        size = math.sqrt(east * east + north * north)
        scale = _ACCEL_UNAIDED_MPS2 / size if (s[_UNAIDED + k] == 1.0) & (size > _ACCEL_UNAIDED_MPS2) else 1.0
        for axis in range(3):
            at = axis * LANES + k
            gain = s[_AX + at] * dt_s
            gain = gain * scale if axis < 2 else gain
            before = s[_VX + at]
            now = clamp(before + gain, -VEL_LIMIT_MPS, VEL_LIMIT_MPS)
            low = -POS_LIMIT_M if axis < 2 else HEIGHT_MIN_M
            high = POS_LIMIT_M if axis < 2 else HEIGHT_MAX_M
            place = clamp(s[_PX + at] + 0.5 * (before + now) * dt_s, low, high)
            s[_VX + at] = now
            s[_PX + at] = place
            s[_OUT_VX + at] = now - s[_PENDING_VX + at]
            s[_OUT_PX + at] = place - s[_PENDING_PX + at]

        half = 0.25 * dt_s
        tx, ty, tz = s[_RX + k], s[_RY + k], s[_RZ + k]
        for axis in range(3):
            at = axis * LANES + k
            bias = s[_BX + at]
            s[_RX + at] = valid_reading(s[_GX + at], s[_RX + at] + bias, GYRO_MAX_RADPS) - bias
        tx = half * (tx + s[_RX + k])
        ty = half * (ty + s[_RY + k])
        tz = half * (tz + s[_RZ + k])
        turn2 = tx * tx + ty * ty + tz * tz
        cosine = 1.0 - turn2 * (0.5 - turn2 / 24.0)
        sine = 1.0 - turn2 / 6.0
        tx *= sine
        ty *= sine
        tz *= sine
        nw = w * cosine - x * tx - y * ty - z * tz
        nx = x * cosine + w * tx + y * tz - z * ty
        ny = y * cosine + w * ty + z * tx - x * tz
        nz = z * cosine + w * tz + x * ty - y * tx
        # one Newton step to unit length: only rounding errors are left
        norm = 1.5 - 0.5 * (nw * nw + nx * nx + ny * ny + nz * nz)
        w, x, y, z = nw * norm, nx * norm, ny * norm, nz * norm
        s[_QW + k], s[_QX + k], s[_QY + k], s[_QZ + k] = w, x, y, z
        yaw, near = yaw_near(s[_YAW_REF + k], s[_YAW_COS + k], s[_YAW_SIN + k], w, x, y, z)
        s[_YAW + k] = yaw
        s[_YAW_NEAR + k] = 1.0 if near else 0.0


@compiled
def update_output(e: Any, k: Any) -> None:
    """Update position, velocity and yaw of the output, which controllers and telemetry use, after a filter step."""
    for axis in range(3):
        e.pos[axis] = k.pos[axis] - k.pending_pos[axis]
        e.vel[axis] = k.vel[axis] - k.pending_vel[axis]
    yaw, near = yaw_near(k.yaw_ref, k.yaw_cos, k.yaw_sin, e.quat[0], e.quat[1], e.quat[2], e.quat[3])
    if near:
        e.yaw = yaw
    else:
        _set_yaw_reference(e, k)


@compiled
def _set_yaw_reference(e: Any, k: Any) -> None:
    """Compute the yaw of the output, and make it the reference of the following ones."""
    w, x, y, z = e.quat[0], e.quat[1], e.quat[2], e.quat[3]
    k.yaw_cos = 1 - 2 * (y * y + z * z)
    k.yaw_sin = 2 * (w * z + x * y)
    k.yaw_ref = elementary.atan2(k.yaw_sin, k.yaw_cos)
    e.yaw = k.yaw_ref


@compiled
def update_roll_pitch(e: Any) -> None:
    """Update roll and pitch of the output from the attitude, in every filter step."""
    w, x, y, z = e.quat[0], e.quat[1], e.quat[2], e.quat[3]
    across = 2 * (w * x + y * z)
    ahead = 1 - 2 * (x * x + y * y)
    if abs(across) < _SERIES_LIMIT * ahead:
        t = across / ahead
        t2 = t * t
        e.roll = t * (1.0 - t2 * (1.0 / 3.0 - t2 * (0.2 - t2 / 7.0)))
    else:
        e.roll = elementary.atan2(across, ahead)
    s = 2 * (w * y - z * x)
    if abs(s) < _SERIES_LIMIT:
        s2 = s * s
        e.pitch = s * (1.0 + s2 * (1.0 / 6.0 + s2 * (0.075 + s2 * 15.0 / 336.0)))
    else:
        e.pitch = elementary.asin(clamp(s, -1.0, 1.0))
