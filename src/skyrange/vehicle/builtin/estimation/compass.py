"""Compass fusion: yaw and the bias of the yaw gyroscope.

EKF3 estimates the fields of the Earth and of the body in six states (FuseMagnetometer). Here the Earth's is known from
the model that also gives the declination, and the body's remains in the reading: a reading is reduced to one angle,
weighted with EK3_MAG_M_NSE over the horizontal part of the field. The gate is EKF3's, on the three components
(EK3_MAG_I_GATE): one outside it rejects all of them, in flight for as long as it lasts, on the ground for 5 s.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.control.shaping import clamp
from skyrange.vehicle.builtin.estimation.covariance import correct_gyro_bias, rotate_attitude
from skyrange.vehicle.builtin.estimation.gnss import gate_squared
from skyrange.vehicle.builtin.estimation.state import HGT_AVG_NS, INTERVAL_MIN_NS, MAG_RESET_NS, EstimatorEvent

Vector3 = tuple[float, float, float]
_YAW = int(EstimatorEvent.YAW_RESET)
_RATE_SCALE = 0.005  # magVarRateScale, gauss per rad/s
_MIN_FIELD_GAUSS = 0.05
"""A smaller horizontal field gives no direction: near a magnetic pole, or without a compass."""
_YAW_SD_RAD = math.radians(5.0)


@compiled
def body_to_local(e: Any, a: float, b: float, c: float) -> tuple[float, float, float]:
    """Rotate a reading to east, north and up with the estimated attitude."""
    w, x, y, z = e.quat[0], e.quat[1], e.quat[2], e.quat[3]
    east = (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c
    north = 2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c
    up = 2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c
    return east, north, up


@compiled
def read_compass(e: Any, k: Any, p: Any, now: int, compass: Vector3, field: Vector3, armed: bool) -> None:  # noqa: FBT001, PLR0917
    """Fuse a reading that is new."""
    since = now - k.compass_at
    same = compass[0] == k.compass[0] and compass[1] == k.compass[1] and compass[2] == k.compass[2]
    if since < INTERVAL_MIN_NS or (same and since < HGT_AVG_NS):
        return
    for axis in range(3):
        if not abs(compass[axis]) < 10.0:
            return
    for axis in range(3):
        k.compass[axis] = compass[axis]
        e.compass[axis] = compass[axis]
    k.compass_at = now
    if k.compass_failed == 1:
        k.mag_test = 0.0
        return
    east, north, up = body_to_local(e, compass[0], compass[1], compass[2])
    level = math.sqrt(field[0] * field[0] + field[1] * field[1])
    if level < _MIN_FIELD_GAUSS or east * east + north * north < _MIN_FIELD_GAUSS * _MIN_FIELD_GAUSS:
        return
    rate2 = k.rate[0] ** 2 + k.rate[1] ** 2 + k.rate[2] ** 2
    noise = clamp(p.EK3_MAG_M_NSE, 0.01, 0.5) ** 2 + _RATE_SCALE * _RATE_SCALE * rate2
    yaw_noise = noise / (level * level)
    # a wrong yaw shows in the horizontal components; their length and the vertical one show a wrong field
    worst = max(max(abs(east - field[0]), abs(north - field[1])), abs(up - field[2]))
    k.mag_test = worst * worst / (gate_squared(p.EK3_MAG_I_GATE) * (noise + k.cov_yaw[0] * level * level))
    off = elementary.atan2(east * field[1] - north * field[0], east * field[0] + north * field[1])
    if k.mag_test < 1.0:
        k.mag_pass = now
        w = k.cov_yaw
        spread = w[0] + yaw_noise
        k_y, k_b = w[0] / spread, w[1] / spread
        w[2] -= k_b * w[1]
        w[0] -= k_y * w[0]
        w[1] -= k_y * w[1]
        rotate_attitude(e, 0.0, 0.0, k_y * off)
        correct_gyro_bias(e, k, 0.0, 0.0, -k_b * off)
    elif not armed and now - k.mag_pass > MAG_RESET_NS:
        align_yaw(e, k, off)
        k.mag_pass = now
        k.events |= _YAW


@compiled
def align_yaw(e: Any, k: Any, by: float) -> None:
    """Turn the estimated attitude about the vertical, by any angle."""
    cosine, sine = elementary.cos(0.5 * by), elementary.sin(0.5 * by)
    w, x, y, z = e.quat[0], e.quat[1], e.quat[2], e.quat[3]
    e.quat[0] = w * cosine - z * sine
    e.quat[1] = x * cosine - y * sine
    e.quat[2] = y * cosine + x * sine
    e.quat[3] = z * cosine + w * sine
    k.cov_yaw[0] = _YAW_SD_RAD * _YAW_SD_RAD
    k.cov_yaw[1] = 0.0
    k.reset_delta_yaw += by
