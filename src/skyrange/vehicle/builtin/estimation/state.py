"""What does the estimator keep of each aircraft? One record, the times it waits for, and what it reports.

All times and limits are EKF3's own constants (libraries/AP_NavEKF3/AP_NavEKF3.h, AP_NavEKF3_core.h); what an operator
may set is a parameter (`EK3_…`).
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Any, Final

import numpy as np

from skyrange.core.time import NS_PER_MS, NS_PER_S

STEP_NS: Final = 10 * NS_PER_MS
"""Between two steps of the filter (`fusionTimeStep_ms`); the strapdown runs at every tick."""
TARGET_DT_S: Final = 0.012
"""EKF_TARGET_DT: EKF3's noise parameters mean this step, so the noise added per second is theirs at any step."""
INTERVAL_MIN_NS: Final = 50 * NS_PER_MS
"""`sensorIntervalMin_ms`: a sensor is read no more often."""
HEIGHT_NS: Final = 100 * NS_PER_MS
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
"""calcGpsGoodToAlign: so long without a failed check to be good, without a passed one to be bad."""
INNOVATION_FAIL_NS: Final = NS_PER_S
INNOVATION_PASS_NS: Final = 10 * NS_PER_S
"""calcGpsGoodForFlight: so long without passing to be glitching, without failing to be well."""
MAG_RESET_NS: Final = 5 * NS_PER_S
"""calcGpsGoodToAlign: a compass that disagrees so long on the ground makes the yaw be aligned anew."""

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
"""Full scale of the inertial sensors, 2000 deg/s and 16 g (ICM-42688-P): more cannot be read."""

SLOTS: Final = 32
"""Past steps kept, to compare a late fix with where the aircraft was when it was measured (`storedOutput`)."""


class Aiding(IntEnum):
    """EKF3's PV_AidingMode."""

    NONE = 0
    """Position unknown: held at the last known one, tilt kept by the assumption of standing still."""
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


class News(IntFlag):
    """What happened in a step that somebody should hear of."""

    STOPPED_AIDING = 1
    STARTED_AIDING = 2
    POSITION_RESET = 4
    VELOCITY_RESET = 8
    HEIGHT_RESET = 16
    YAW_RESET = 32


FILTER: Final = np.dtype(
    [
        # what every tick touches, together: the state, local frame
        ("pos", "f8", (3,)),
        ("vel", "f8", (3,)),
        ("slack_pos", "f8", (3,)),  # corrections made but not shown yet
        ("slack_vel", "f8", (3,)),
        ("rate", "f8", (3,)),  # the last inertial readings
        ("force", "f8", (3,)),
        ("gyro_bias", "f8", (3,)),  # rad/s, body
        ("accel_bias", "f8"),  # m/s², up
        ("yaw_cos", "f8"),
        ("yaw_sin", "f8"),
        ("yaw_from", "f8"),  # the yaw of that direction
        ("aiding", "i8"),
        ("news", "i8"),
        # the sum of all corrections, and what resets have moved since the references followed
        ("moved_pos", "f8", (3,)),
        ("moved_vel", "f8", (3,)),
        ("shift_pos", "f8", (3,)),
        ("shift_vel", "f8", (3,)),
        ("shift_yaw", "f8"),
        ("accel_slow", "f8", (3,)),  # velDotNEDfilt
        # variances, upper triangles: (position, velocity, tilt, gyro bias), the same for east and north;
        # (height, climb, accelerometer bias); (yaw, gyro bias)
        ("level", "f8", (10,)),
        ("up", "f8", (6,)),
        ("turn", "f8", (3,)),
        # aiding
        ("held", "f8", (2,)),  # lastKnownPositionNE
        ("pos_timeout", "i8"),
        ("vel_timeout", "i8"),
        ("hgt_timeout", "i8"),
        ("vel_aiding", "i8"),
        ("pos_pass", "i8"),  # when each last passed its gate, ns
        ("vel_pass", "i8"),
        ("hgt_pass", "i8"),
        ("mag_pass", "i8"),
        ("pos_test", "f8"),  # test ratios: above 1 is outside the gate
        ("vel_test", "f8"),
        ("hgt_test", "f8"),
        ("mag_test", "f8"),
        # GNSS
        ("fix_time", "i8"),  # when the last fix was measured
        ("fix_at", "i8"),  # when it came
        ("gnss_vel", "f8", (3,)),
        ("pos_acc", "f8"),
        ("spd_acc", "f8"),
        ("good", "i8"),  # gpsGoodToAlign
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
        ("hgt_off", "f8"),  # the last reading less what was believed, m
        ("bad", "i8"),  # badIMUdata
        ("bad_at", "i8"),  # when it was last detected
        ("good_at", "i8"),  # when it was last not
        ("compass", "f8", (3,)),
        ("compass_at", "i8"),
    ]
)
"""One aircraft's filter."""


def blank(count: int) -> Any:
    """Records and history of a filter that has not been started."""
    return np.zeros(count, dtype=FILTER), np.zeros((count, SLOTS, 6))
