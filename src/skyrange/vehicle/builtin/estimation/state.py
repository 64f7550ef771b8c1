"""State of the estimator: one record per aircraft, EKF3's time-outs and limits, and the events that it reports.

All times and limits are EKF3's own constants (libraries/AP_NavEKF3/AP_NavEKF3.h, AP_NavEKF3_core.h); what an operator
can set is a parameter (`EK3_…`).
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Any, Final

import numpy as np

from skyrange.core.time import NS_PER_MS, NS_PER_S

STEP_NS: Final = 10 * NS_PER_MS
"""Interval of filter steps (`fusionTimeStep_ms`); the strapdown runs in every tick."""
TARGET_DT_S: Final = 0.012
"""EKF_TARGET_DT: EKF3's noise parameters apply to this step, so the noise added per second is the same at any step."""
INTERVAL_MIN_NS: Final = 50 * NS_PER_MS
"""`sensorIntervalMin_ms`: minimum interval between readings of a sensor."""
HGT_AVG_NS: Final = 100 * NS_PER_MS
"""`hgtAvg_ms`."""
POS_RETRY_USE_VEL_NS: Final = 10 * NS_PER_S
"""`posRetryTimeUseVel_ms`."""
POS_RETRY_NO_VEL_NS: Final = 7 * NS_PER_S
"""`posRetryTimeNoVel_ms`."""
TILT_DRIFT_MAX_NS: Final = 15 * NS_PER_S
"""`tiltDriftTimeMax_ms`."""
HGT_RETRY_VEL_NS: Final = 10 * NS_PER_S
"""`hgtRetryTimeMode0_ms`, with vertical velocity from GNSS."""
HGT_RETRY_NS: Final = 5 * NS_PER_S
"""`hgtRetryTimeMode12_ms`."""
GPS_PASS_NS: Final = 10 * NS_PER_S
GPS_FAIL_NS: Final = 5 * NS_PER_S
"""calcGpsGoodToAlign: time without a failed check to be good, and without a passed one to be bad."""
INNOVATION_FAIL_NS: Final = NS_PER_S
INNOVATION_PASS_NS: Final = 10 * NS_PER_S
"""calcGpsGoodForFlight: time without passing to be glitching, and without failing to be good."""
MAG_RESET_NS: Final = 5 * NS_PER_S
"""calcGpsGoodToAlign: a compass that disagrees for this time on the ground has the yaw aligned again."""

POS_LIMIT_M: Final = 1.0e6
HEIGHT_MIN_M: Final = -1.0e4
HEIGHT_MAX_M: Final = 4.0e4
VEL_LIMIT_MPS: Final = 500.0
GYRO_BIAS_LIMIT_RADPS: Final = 0.5
VARIANCE_MIN: Final = 1e-4
VEL_VARIANCE_MAX: Final = 1e3
POS_VARIANCE_MAX: Final = 1e6
"""ConstrainStates and ConstrainVariances."""
GYRO_MAX_RADPS: Final = 34.9
ACCEL_MAX_MPS2: Final = 157.0
"""Full scale of the inertial sensors, 2000 deg/s and 16 g (ICM-42688-P): larger values cannot be read."""

HISTORY_LENGTH: Final = 32
"""Past steps stored, to compare a delayed fix with the state when it was measured (`storedOutput`)."""


class Aiding(IntEnum):
    """EKF3's PV_AidingMode."""

    NONE = 0
    """Position unknown: held at the last known one, tilt kept by the assumption of rest."""
    ABSOLUTE = 1
    """By GNSS, or by extrapolation while there is none."""


class Status(IntFlag):
    """MAVLink's EKF_STATUS_FLAGS, as EKF_STATUS_REPORT carries them."""

    ATTITUDE = 1
    VELOCITY_HORIZ = 2
    VELOCITY_VERT = 4
    POS_HORIZ_REL = 8
    POS_HORIZ_ABS = 16
    POS_VERT_ABS = 32
    POS_VERT_AGL = 64
    CONST_POS_MODE = 128
    PRED_POS_HORIZ_REL = 256
    PRED_POS_HORIZ_ABS = 512
    UNINITIALIZED = 1024
    GPS_GLITCHING = 1 << 15


class EstimatorEvent(IntFlag):
    """Events of a step."""

    STOPPED_AIDING = 1
    STARTED_AIDING = 2
    POSITION_RESET = 4
    VELOCITY_RESET = 8
    HEIGHT_RESET = 16
    YAW_RESET = 32
    EMERGENCY_YAW_RESET = 64
    YAW_ALIGNED_BY_GNSS = 128


FILTER: Final = np.dtype(
    [
        # used in every tick, kept together: the state, local frame
        ("pos", "f8", (3,)),
        ("vel", "f8", (3,)),
        ("pending_pos", "f8", (3,)),  # corrections that the output does not contain yet
        ("pending_vel", "f8", (3,)),
        ("rate", "f8", (3,)),  # the last inertial readings
        ("force", "f8", (3,)),
        ("gyro_bias", "f8", (3,)),  # rad/s, body
        ("accel_bias", "f8"),  # m/s², up
        ("yaw_cos", "f8"),
        ("yaw_sin", "f8"),
        ("yaw_ref", "f8"),  # yaw of that direction
        ("aiding", "i8"),
        ("events", "i8"),
        # sum of all corrections; deltas of resets that the references have not followed yet
        ("corrected_pos", "f8", (3,)),
        ("corrected_vel", "f8", (3,)),
        ("reset_delta_pos", "f8", (3,)),
        ("reset_delta_vel", "f8", (3,)),
        ("reset_delta_yaw", "f8"),
        ("accel_slow", "f8", (3,)),  # velDotNEDfilt
        # variances, upper triangles: (position, velocity, tilt, gyro bias), the same for east and north;
        # (height, climb, accelerometer bias); (yaw, gyro bias)
        ("cov_horizontal", "f8", (10,)),
        ("cov_vertical", "f8", (6,)),
        ("cov_yaw", "f8", (3,)),
        # aiding
        ("last_known_pos", "f8", (2,)),  # lastKnownPositionNE
        ("pos_timeout", "i8"),
        ("vel_timeout", "i8"),
        ("hgt_timeout", "i8"),
        ("vel_aiding", "i8"),
        ("pos_pass", "i8"),  # when each was last accepted, ns
        ("vel_pass", "i8"),
        ("hgt_pass", "i8"),
        ("mag_pass", "i8"),
        ("pos_test", "f8"),  # test ratios: above 1 is outside the gate
        ("vel_test", "f8"),
        ("hgt_test", "f8"),
        ("mag_test", "f8"),
        # GNSS
        ("fix_time", "i8"),  # when the last fix was measured
        ("fix_at", "i8"),  # when it arrived
        ("gnss_vel", "f8", (3,)),
        ("pos_acc", "f8"),
        ("spd_acc", "f8"),
        ("gps_good_to_align", "i8"),  # gpsGoodToAlign
        ("check_pass", "i8"),
        ("check_fail", "i8"),
        ("innov_good", "i8"),
        ("innov_pass", "i8"),
        ("innov_fail", "i8"),
        ("sacc_low", "f8"),
        ("sacc_peak", "f8"),
        ("sacc_good", "i8"),
        # barometer and compass
        ("baro", "f8"),
        ("baro_at", "i8"),
        ("hgt_innov", "f8"),  # innovation of the last reading, m
        ("bad_imu", "i8"),  # badIMUdata
        ("bad_imu_at", "i8"),  # when it was last detected
        ("good_imu_at", "i8"),  # when data were last good
        ("compass", "f8", (3,)),
        ("compass_at", "i8"),
        ("compass_failed", "i8"),  # allMagSensorsFailed
        # yaw by GNSS: (east, north, yaw relative to the estimated one), upper triangle of their variances
        ("gsf_running", "i8"),
        ("gsf_vel", "f8", (2,)),
        ("gsf_yaw", "f8"),
        ("gsf_cov", "f8", (6,)),
        ("gsf_imu_vel", "f8", (2,)),  # sum of accelerations at the last fix
        ("gsf_at", "i8"),  # when that was measured
        ("gsf_innovation", "f8"),  # m/s
        ("gsf_request_at", "i8"),  # when a reset was requested, 0 for none
        ("gsf_resets", "i8"),
    ]
)
"""One aircraft's filter."""


def new_filters(count: int) -> Any:
    """Return records and history of filters that have not been started."""
    return np.zeros(count, dtype=FILTER), np.zeros((count, HISTORY_LENGTH, 6))
