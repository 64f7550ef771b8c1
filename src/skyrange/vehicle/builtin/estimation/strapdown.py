"""Strapdown inertial navigation: gyroscopes and accelerometers, integrated from tick to tick.

EKF3's UpdateStrapdownEquationsNED and calcOutputStates: attitude by the mean rate, velocity by the specific force in
the attitude before it, position by the mean of two velocities. The output follows the state with the corrections
applied over EK3_TAU_OUTPUT, so that no measurement makes the controllers jump; attitude is output as it is.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core.compiled import compiled
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

Vector3 = tuple[float, float, float]
_NONE = int(Aiding.NONE)
_SERIES_LIMIT = 0.05  # tangent below which an angle is computed by a series
_ACCEL_UNAIDED_MPS2 = 5.0  # UpdateStrapdownEquationsNED: manoeuvres without aiding


@compiled
def valid_reading(value: float, before: float, most: float) -> float:
    """Return a plausible sensor value: the last one instead of a NaN, full scale instead of more."""
    if value != value:
        return before
    return clamp(value, -most, most)


@compiled
def update_strapdown(e: Any, k: Any, gyro: Vector3, accel: Vector3, dt_s: float) -> None:
    """Advance the state by a tick, with everything of the estimate that changes in every tick.

    Readings are passed as numbers because a compiled function that is passed an array counts a reference to it, which
    takes as long.
    """
    w, x, y, z = e.quat[0], e.quat[1], e.quat[2], e.quat[3]
    for axis in range(3):
        k.force[axis] = valid_reading(accel[axis], k.force[axis], ACCEL_MAX_MPS2)
    a, b, c = k.force[0], k.force[1], k.force[2]
    east = (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c
    north = 2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c
    up = 2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c
    e.accel[0] = east
    e.accel[1] = north
    e.accel[2] = up - GRAVITY_MPS2 - k.accel_bias
    scale = 1.0
    if k.aiding == _NONE:
        size = math.sqrt(east * east + north * north)
        if size > _ACCEL_UNAIDED_MPS2:
            scale = _ACCEL_UNAIDED_MPS2 / size
    for axis in range(3):
        before = k.vel[axis]
        gain = e.accel[axis] * dt_s
        if axis < 2:
            gain *= scale
        k.vel[axis] = clamp(before + gain, -VEL_LIMIT_MPS, VEL_LIMIT_MPS)
        k.pos[axis] += 0.5 * (before + k.vel[axis]) * dt_s
    k.pos[0] = clamp(k.pos[0], -POS_LIMIT_M, POS_LIMIT_M)
    k.pos[1] = clamp(k.pos[1], -POS_LIMIT_M, POS_LIMIT_M)
    k.pos[2] = clamp(k.pos[2], HEIGHT_MIN_M, HEIGHT_MAX_M)

    half = 0.25 * dt_s
    tx, ty, tz = k.rate[0], k.rate[1], k.rate[2]
    for axis in range(3):
        bias = k.gyro_bias[axis]
        k.rate[axis] = valid_reading(gyro[axis], k.rate[axis] + bias, GYRO_MAX_RADPS) - bias
        e.rate[axis] = k.rate[axis]
    tx = half * (tx + k.rate[0])
    ty = half * (ty + k.rate[1])
    tz = half * (tz + k.rate[2])
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
    e.quat[0] = nw * norm
    e.quat[1] = nx * norm
    e.quat[2] = ny * norm
    e.quat[3] = nz * norm


@compiled
def update_output(e: Any, k: Any) -> None:
    """Update position, velocity and yaw of the output, which controllers and telemetry use."""
    for axis in range(3):
        e.pos[axis] = k.pos[axis] - k.pending_pos[axis]
        e.vel[axis] = k.vel[axis] - k.pending_vel[axis]
    w, x, y, z = e.quat[0], e.quat[1], e.quat[2], e.quat[3]
    cosine = 1 - 2 * (y * y + z * z)
    sine = 2 * (w * z + x * y)
    # small changes from a known angle by a series, exact to 1e-12: atan2 in every tick would cost as much as the rest
    across = k.yaw_cos * sine - k.yaw_sin * cosine
    ahead = k.yaw_cos * cosine + k.yaw_sin * sine
    if abs(across) < _SERIES_LIMIT * ahead:
        t = across / ahead
        t2 = t * t
        yaw = k.yaw_ref + t * (1.0 - t2 * (1.0 / 3.0 - t2 * (0.2 - t2 / 7.0)))
        if yaw >= math.pi:
            yaw -= 2.0 * math.pi
        elif yaw < -math.pi:
            yaw += 2.0 * math.pi
        e.yaw = yaw
    else:
        k.yaw_cos = cosine
        k.yaw_sin = sine
        k.yaw_ref = math.atan2(sine, cosine)
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
        e.roll = math.atan2(across, ahead)
    s = 2 * (w * y - z * x)
    if abs(s) < _SERIES_LIMIT:
        s2 = s * s
        e.pitch = s * (1.0 + s2 * (1.0 / 6.0 + s2 * (0.075 + s2 * 15.0 / 336.0)))
    else:
        e.pitch = math.asin(clamp(s, -1.0, 1.0))
