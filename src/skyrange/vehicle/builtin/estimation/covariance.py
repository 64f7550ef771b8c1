"""Covariances of the estimator, and the updates by measurements: three small Kalman filters in error form.

EKF3 has 24 states with one covariance. Near hover its blocks are weakly coupled; here they are separate:

- horizontal: position, velocity, tilt, gyro bias of one horizontal axis. East and north have the same noise, the same
  measurements and the same dynamics (tilt times g is acceleration), so one 4 x 4 matrix serves both.
- vertical: height, climb rate, accelerometer bias.
- yaw: yaw, gyro bias.

Packed upper triangles: horizontal (pp, pv, pt, pb, vv, vt, vb, tt, tb, bb), vertical (pp, pv, pa, vv, va, aa), yaw
(yy, yb, bb). Process noise is EKF3's (CovariancePrediction): EK3_ACC_P_NSE and EK3_GYRO_P_NSE per sample of
EKF_TARGET_DT.
"""

from __future__ import annotations

from typing import Any

from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.control.gains import GRAVITY_MPS2
from skyrange.vehicle.builtin.control.shaping import clamp
from skyrange.vehicle.builtin.estimation.bad_imu import ACCEL_NOISE_MPS2
from skyrange.vehicle.builtin.estimation.state import POS_VARIANCE_MAX, TARGET_DT_S, VARIANCE_MIN, VEL_VARIANCE_MAX


@compiled
def predict(k: Any, p: Any, dt_s: float) -> None:
    """Add the uncertainty of a step."""
    noise_s = TARGET_DT_S * dt_s
    spread = p.EK3_ACC_P_NSE if k.bad_imu == 0 else ACCEL_NOISE_MPS2
    accel = spread * spread * noise_s
    gyro = p.EK3_GYRO_P_NSE * p.EK3_GYRO_P_NSE * noise_s
    gyro_bias = p.EK3_GBIAS_P_NSE * p.EK3_GBIAS_P_NSE * noise_s
    accel_bias = p.EK3_ABIAS_P_NSE * p.EK3_ABIAS_P_NSE * noise_s

    c = k.cov_horizontal
    pull = GRAVITY_MPS2 * dt_s
    pp, pv, pt, pb = c[0], c[1], c[2], c[3]
    vv, vt, vb = c[4], c[5], c[6]
    tt, tb, bb = c[7], c[8], c[9]
    a_pv = pv + dt_s * vv
    a_pt = pt + dt_s * vt
    a_pb = pb + dt_s * vb
    a_vt = vt + pull * tt
    a_vb = vb + pull * tb
    c[0] = clamp(pp + dt_s * pv + dt_s * a_pv, VARIANCE_MIN, POS_VARIANCE_MAX)
    c[1] = a_pv + pull * a_pt
    c[2] = a_pt + dt_s * a_pb
    c[3] = a_pb
    c[4] = clamp(vv + pull * vt + pull * a_vt + accel, VARIANCE_MIN, VEL_VARIANCE_MAX)
    c[5] = a_vt + dt_s * a_vb
    c[6] = a_vb
    c[7] = min(tt + dt_s * tb + dt_s * (tb + dt_s * bb) + gyro, 1.0)
    c[8] = tb + dt_s * bb
    c[9] = min(bb + gyro_bias, 0.175 * 0.175)

    u = k.cov_vertical
    pp, pv, pa, vv, va, aa = u[0], u[1], u[2], u[3], u[4], u[5]
    a_pv = pv + dt_s * vv
    a_pa = pa + dt_s * va
    u[0] = clamp(pp + dt_s * pv + dt_s * a_pv, VARIANCE_MIN, POS_VARIANCE_MAX)
    u[1] = a_pv - dt_s * a_pa
    u[2] = a_pa
    u[3] = clamp(vv - dt_s * va - dt_s * (va - dt_s * aa) + accel, VARIANCE_MIN, VEL_VARIANCE_MAX)
    u[4] = va - dt_s * aa
    u[5] = min(aa + accel_bias, 1.0)
    if k.bad_imu == 1:  # ConstrainVariances: variances not below those of the sensors
        u[0] = max(u[0], p.EK3_ALT_M_NSE * p.EK3_ALT_M_NSE)
        u[3] = max(u[3], p.EK3_VELD_M_NSE * p.EK3_VELD_M_NSE)

    w = k.cov_yaw
    w[0] = min(w[0] + 2.0 * dt_s * w[1] + dt_s * dt_s * w[2] + gyro, 1.0)
    w[1] += dt_s * w[2]
    w[2] = min(w[2] + gyro_bias, 0.175 * 0.175)


@compiled
def update_horizontal_covariance(
    c: Any, a: float, b: float, d: float, g: float, variance: float
) -> tuple[float, float, float, float]:
    """Update the horizontal covariance by a measurement whose row is (a, b, d, g); return the gains."""
    k_p, k_v, k_t, k_b = a / variance, b / variance, d / variance, g / variance
    c[0] -= k_p * a
    c[1] -= k_p * b
    c[2] -= k_p * d
    c[3] -= k_p * g
    c[4] -= k_v * b
    c[5] -= k_v * d
    c[6] -= k_v * g
    c[7] -= k_t * d
    c[8] -= k_t * g
    c[9] -= k_b * g
    return k_p, k_v, k_t, k_b


@compiled
def update_vertical_covariance(c: Any, a: float, b: float, d: float, variance: float) -> tuple[float, float, float]:
    """Update the vertical covariance by a measurement whose row is (a, b, d); return the gains."""
    k_p, k_v, k_a = a / variance, b / variance, d / variance
    c[0] -= k_p * a
    c[1] -= k_p * b
    c[2] -= k_p * d
    c[3] -= k_v * b
    c[4] -= k_v * d
    c[5] -= k_a * d
    return k_p, k_v, k_a


@compiled
def correct_horizontal(e: Any, k: Any, gains: tuple[float, float, float, float], east: float, north: float) -> None:
    """Correct the state by two innovations (measured minus estimated)."""
    k_p, k_v, k_t, k_b = gains
    for axis in range(2):
        by = east if axis == 0 else north
        k.pos[axis] += k_p * by
        k.pending_pos[axis] += k_p * by
        k.corrected_pos[axis] += k_p * by
        k.vel[axis] += k_v * by
        k.pending_vel[axis] += k_v * by
        k.corrected_vel[axis] += k_v * by
    # tilt about north accelerates east, about east accelerates south
    rotate_attitude(e, -k_t * north, k_t * east, 0.0)
    correct_gyro_bias(e, k, k_b * north, -k_b * east, 0.0)


@compiled
def correct_vertical(k: Any, gains: tuple[float, float, float], by: float) -> None:
    """Correct height, climb rate and bias by an innovation."""
    k_p, k_v, k_a = gains
    k.pos[2] += k_p * by
    k.pending_pos[2] += k_p * by
    k.corrected_pos[2] += k_p * by
    k.vel[2] += k_v * by
    k.pending_vel[2] += k_v * by
    k.corrected_vel[2] += k_v * by
    if k.bad_imu == 0:
        k.accel_bias += k_a * by


@compiled
def rotate_attitude(e: Any, east: float, north: float, up: float) -> None:
    """Rotate the attitude by a small vector, radians in the local frame."""
    a, b, c = 0.5 * east, 0.5 * north, 0.5 * up
    w, x, y, z = e.quat[0], e.quat[1], e.quat[2], e.quat[3]
    e.quat[0] = w - a * x - b * y - c * z
    e.quat[1] = x + a * w + b * z - c * y
    e.quat[2] = y + b * w + c * x - a * z
    e.quat[3] = z + c * w + a * y - b * x


@compiled
def correct_gyro_bias(e: Any, k: Any, east: float, north: float, up: float) -> None:
    """Add a vector of the local frame, rad/s, to the gyro bias, which is in the body frame."""
    w, x, y, z = e.quat[0], e.quat[1], e.quat[2], e.quat[3]
    k.gyro_bias[0] += (1 - 2 * (y * y + z * z)) * east + 2 * (x * y + w * z) * north + 2 * (x * z - w * y) * up
    k.gyro_bias[1] += 2 * (x * y - w * z) * east + (1 - 2 * (x * x + z * z)) * north + 2 * (y * z + w * x) * up
    k.gyro_bias[2] += 2 * (x * z + w * y) * east + 2 * (y * z - w * x) * north + (1 - 2 * (x * x + y * y)) * up


@compiled
def reset_position_variance(k: Any, variance: float) -> None:
    """Set the variance of the position and clear its correlations."""
    c = k.cov_horizontal
    c[0], c[1], c[2], c[3] = variance, 0.0, 0.0, 0.0


@compiled
def reset_velocity_variance(k: Any, variance: float) -> None:
    """Set the variance of the horizontal velocity and clear its correlations."""
    c = k.cov_horizontal
    c[1], c[4], c[5], c[6] = 0.0, variance, 0.0, 0.0
