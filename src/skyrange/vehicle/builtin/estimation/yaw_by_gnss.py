"""Yaw from the acceleration by GNSS, with which EKF3 resets itself before an EKF failsafe (EKF-GSF).

After AP_NavEKF/EKFGSF_yaw.cpp and `EKFGSF_resetMainFilterYaw` (AP_NavEKF3_MagFusion.cpp). ArduPilot runs a bank of five
filters at the rate of its inertial sensors, each of velocity and yaw, started 72 degrees apart. Here is one of them,
the one whose yaw is nearest to the estimated one, updated at each fix: the others have no weight once an aircraft has
changed its speed by some metres per second. Its attitude is the estimated one, turned by `gsf_yaw` about the vertical.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.builtin.control.shaping import wrap_pi
from skyrange.vehicle.builtin.estimation.compass import align_yaw
from skyrange.vehicle.builtin.estimation.covariance import reset_position_variance, reset_velocity_variance
from skyrange.vehicle.builtin.estimation.gnss import set_position, set_velocity
from skyrange.vehicle.builtin.estimation.state import HISTORY_LENGTH, STEP_NS, TARGET_DT_S, Aiding, EstimatorEvent

_ABSOLUTE = int(Aiding.ABSOLUTE)
_YAW = int(EstimatorEvent.YAW_RESET)
_EMERGENCY = int(EstimatorEvent.EMERGENCY_YAW_RESET)
_ALIGNED = int(EstimatorEvent.YAW_ALIGNED_BY_GNSS)
_START_YAW_RAD = math.radians(36.0)
"""Half of the interval between the yaws at which the five filters start (`resetEKFGSF`)."""
_ACCEL_NOISE = 2.0 * 2.0 * TARGET_DT_S
"""EKFGSF_accelNoise, (m/s²)², at EKF3's step: (m/s)² that are added per second."""
_GYRO_NOISE = 0.1 * 0.1 * TARGET_DT_S
"""EKFGSF_gyroNoise, (rad/s)², likewise: rad² per second."""
_VELOCITY_NOISE_MIN_MPS = 0.5
"""`fuseVelData`: the smallest accuracy of a velocity."""
_SCALED_FROM = 25.0
"""`correct`: innovations above 5 standard deviations are scaled down to them."""
_YAW_ACCURACY_RAD = math.radians(15.0)
"""GSF_YAW_ACCURACY_THRESHOLD_DEG."""
_INNOVATION_MAX_MPS = 2.0
"""`maxYawEstVelInnov`: with a larger innovation the yaw is not used."""
_RESETS_MAX = 2
"""EK3_GSF_RST_MAX."""
_REQUEST_NS = 5 * NS_PER_S
"""YAW_RESET_TO_GSF_TIMEOUT_MS."""
_FIX_AGE_NS = NS_PER_S // 4
"""ResetVelocity, ResetPosition: the age up to which a fix is used."""


@compiled
def fuse_velocity(  # noqa: PLR0917
    k: Any,
    measured: int,
    history: Any,
    i: int,
    slot: int,
    now: int,
    armed: bool,  # noqa: FBT001
) -> None:
    """Update the yaw with the velocity of a fix (`k.gnss_vel`), measured at `measured`; it runs while armed."""
    if not armed:
        k.gsf_running = 0
        k.gsf_resets = 0
        k.compass_failed = 0
        return
    if k.sacc_good == 0:
        k.gsf_running = 0
        return
    late = min(max(now - measured, 0), (HISTORY_LENGTH - 2) * STEP_NS)
    then = history[i, (slot - (late + STEP_NS // 2) // STEP_NS) & (HISTORY_LENGTH - 1)]
    noise = max(k.spd_acc, _VELOCITY_NOISE_MIN_MPS) ** 2
    c = k.gsf_cov
    if k.gsf_running == 0:
        k.gsf_running = 1
        k.gsf_yaw = 0.0
        c[0], c[1], c[2], c[3], c[4], c[5] = noise, 0.0, 0.0, noise, 0.0, _START_YAW_RAD * _START_YAW_RAD
        for axis in range(2):
            k.gsf_vel[axis] = k.gnss_vel[axis]
            k.gsf_imu_vel[axis] = then[3 + axis]
        k.gsf_innovation = 0.0
        k.gsf_at = measured
        return
    dt_s = min(max(measured - k.gsf_at, 0), NS_PER_S) / NS_PER_S
    k.gsf_at = measured
    cosine, sine = elementary.cos(k.gsf_yaw), elementary.sin(k.gsf_yaw)
    d_e, d_n = then[3] - k.gsf_imu_vel[0], then[4] - k.gsf_imu_vel[1]
    k.gsf_imu_vel[0], k.gsf_imu_vel[1] = then[3], then[4]
    east, north = cosine * d_e - sine * d_n, sine * d_e + cosine * d_n
    k.gsf_vel[0] += east
    k.gsf_vel[1] += north
    # d velocity / d yaw is (-north, east)
    p02, p12 = c[2] - north * c[5], c[4] + east * c[5]
    p00 = c[0] - north * (c[2] + p02) + _ACCEL_NOISE * dt_s
    p01 = c[1] + east * c[2] - north * p12
    p11 = c[3] + east * (c[4] + p12) + _ACCEL_NOISE * dt_s
    p22 = c[5] + _GYRO_NOISE * dt_s
    i_e, i_n = k.gsf_vel[0] - k.gnss_vel[0], k.gsf_vel[1] - k.gnss_vel[1]
    s00, s11 = p00 + noise, p11 + noise
    inverse = 1.0 / (s00 * s11 - p01 * p01)
    w_e, w_n = (s11 * i_e - p01 * i_n) * inverse, (s00 * i_n - p01 * i_e) * inverse
    test = i_e * w_e + i_n * w_n
    scale = math.sqrt(_SCALED_FROM / test) if test > _SCALED_FROM else 1.0
    k.gsf_innovation = math.sqrt(i_e * i_e + i_n * i_n)
    k.gsf_vel[0] -= scale * (p00 * w_e + p01 * w_n)
    k.gsf_vel[1] -= scale * (p01 * w_e + p11 * w_n)
    k.gsf_yaw = wrap_pi(k.gsf_yaw - scale * (p02 * w_e + p12 * w_n))
    a00, a01 = (s11 * p00 - p01 * p01) * inverse, (s00 * p01 - p01 * p00) * inverse
    a10, a11 = (s11 * p01 - p01 * p11) * inverse, (s00 * p11 - p01 * p01) * inverse
    a20, a21 = (s11 * p02 - p01 * p12) * inverse, (s00 * p12 - p01 * p02) * inverse
    c[0] = max(p00 - a00 * p00 - a01 * p01, 1e-6)
    c[1] = p01 - a00 * p01 - a01 * p11
    c[2] = p02 - a00 * p02 - a01 * p12
    c[3] = max(p11 - a10 * p01 - a11 * p11, 1e-6)
    c[4] = p12 - a10 * p02 - a11 * p12
    c[5] = max(p22 - a20 * p02 - a21 * p12, 1e-6)


@compiled
def reset_on_request(e: Any, k: Any, p: Any, now: int) -> None:
    """Reset yaw, velocity and position if that was requested (`e.yaw_reset`) and the yaw by GNSS can be used.

    The compass is not used from then on, so that it does not turn the yaw back.
    """
    if e.yaw_reset == 1:
        e.yaw_reset = 0
        k.gsf_request_at = now
    if k.gsf_request_at == 0:
        return
    if now - k.gsf_request_at >= _REQUEST_NS:
        k.gsf_request_at = 0
        return
    usable = k.gsf_cov[5] < _YAW_ACCURACY_RAD * _YAW_ACCURACY_RAD and k.gsf_innovation < _INNOVATION_MAX_MPS
    if k.gsf_running == 0 or not usable or k.gsf_resets >= _RESETS_MAX or k.aiding != _ABSOLUTE:
        return
    k.gsf_request_at = 0
    k.gsf_resets += 1
    align_yaw(e, k, k.gsf_yaw)
    k.cov_yaw[0] = k.gsf_cov[5]
    k.gsf_yaw = 0.0
    k.events |= _YAW | (_EMERGENCY if k.compass_failed == 0 else _ALIGNED)
    k.compass_failed = 1
    if now - k.fix_at < _FIX_AGE_NS:
        age_s = min(max(now - k.fix_time, 0), NS_PER_S) / NS_PER_S
        set_velocity(k, k.gnss_vel[0], k.gnss_vel[1])
        set_position(k, e.gnss_pos[0] + k.gnss_vel[0] * age_s, e.gnss_pos[1] + k.gnss_vel[1] * age_s)
    reset_velocity_variance(k, max(p.EK3_VELNE_M_NSE, k.spd_acc) ** 2)
    reset_position_variance(k, max(p.EK3_POSNE_M_NSE, k.pos_acc) ** 2)
    k.pos_timeout = k.vel_timeout = 0
    k.pos_pass = k.vel_pass = now
    k.pos_test = k.vel_test = 0.0
    e.resets += 1
