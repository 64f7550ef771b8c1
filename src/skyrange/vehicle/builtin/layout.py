"""What state does the array side keep of each aircraft? Two record layouts: the estimate, and flight.

Records, one per aircraft, are what the kernels read and write; nothing in a row depends on another
row. Local frame east-north-up from the origin, body frame forward-left-up, angles in radians
counter-clockwise from east, SI units. `estimate` is the seam for an estimator: control and
telemetry read it and nothing else about where the aircraft is.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Records = NDArray[Any]
"""A structured array, one record per aircraft."""

ESTIMATE: Final = np.dtype(
    [
        ("pos", "f8", (3,)),  # m
        ("vel", "f8", (3,)),  # m/s
        ("quat", "f8", (4,)),  # w, x, y, z body to local
        ("rate", "f8", (3,)),  # rad/s, body
        ("accel", "f8", (3,)),  # m/s², local, gravity taken off: 0 at rest
        ("roll", "f8"),  # FLU: right side down positive
        ("pitch", "f8"),  # FLU: nose down positive
        ("yaw", "f8"),
        ("height", "f8"),  # m above the ground below
        # the estimator's own account, as EKF_STATUS_REPORT has it
        ("status", "i8"),  # MAVLink's EKF_STATUS_FLAGS
        ("vel_ratio", "f8"),  # normalised innovations: above 1 is outside the gate
        ("pos_ratio", "f8"),
        ("hgt_ratio", "f8"),
        ("mag_ratio", "f8"),
        ("dead_reckoning", "i8"),  # 1 while horizontal aiding is lost and position is extrapolated
        ("resets", "i8"),  # horizontal position resets so far
        # what the sensors said last: the receiver, not the estimate
        ("gnss_fix", "i8"),  # MAVLink's GPS_FIX_TYPE
        ("gnss_sats", "i8"),
        ("gnss_hdop", "f8"),
        ("gnss_pos", "f8", (3,)),
        ("gnss_vel", "f8", (3,)),
        ("gnss_age_s", "f8"),  # since the last fix came
        ("baro_up", "f8"),
        ("compass", "f8", (3,)),  # gauss, body
        ("battery_v", "f8"),
        ("battery_a", "f8"),
        ("imu_accel", "f8", (3,)),  # m/s², body, specific force
    ]
)

_PLAN: Final[list[Any]] = [
    ("unit", "f8", (3,)),  # direction of the leg
    ("origin", "f8", (3,)),
    ("length", "f8"),
    ("start", "f8"),  # distance along the leg where the current plan begins
    ("v0", "f8"),
    ("peak", "f8"),
    ("t_up", "f8"),  # durations: to the peak speed, at it, to rest
    ("t_cruise", "f8"),
    ("t_down", "f8"),
    ("t", "f8"),  # time into the plan
    ("accel", "f8"),
    ("jerk", "f8"),
]
PLAN: Final = np.dtype(_PLAN)
"""A jerk-limited run along a straight leg, ending at rest."""

FLIGHT: Final = np.dtype(
    [
        ("armed", "i8"),
        ("control", "i8"),  # a Control
        ("landed", "i8"),
        ("flags", "i8"),  # Flags raised by the loop
        ("seen", "i8"),  # of them, those already acted on
        ("spool", "f8"),  # 0 ground idle … 1 full range
        # the reference, which control follows
        ("ref_pos", "f8", (3,)),
        ("ref_vel", "f8", (3,)),
        ("ref_acc", "f8", (3,)),
        ("ref_yaw", "f8"),
        ("ref_yaw_rate", "f8"),
        # what the reference moves to
        ("target_pos", "f8", (3,)),
        ("target_vel", "f8", (3,)),
        ("target_yaw", "f8"),
        ("ground", "f8"),  # height of the take-off point above the origin, m
        # limits in force
        ("speed_xy", "f8"),
        ("speed_up", "f8"),
        ("speed_down", "f8"),
        ("accel_xy", "f8"),
        ("accel_z", "f8"),
        # the leg being flown and the end of the one before, which still fades out at a corner
        ("leg", _PLAN),
        ("tail", _PLAN),
        ("fast", "i8"),  # pass the leg's end without stopping
        ("replan", "i8"),  # the speed changed
        ("radius", "f8"),  # acceptance radius, m
        ("track_lag", "f8"),  # how much slower than time the leg's reference advances, 0 … 1
        # controllers' memory
        ("vel_err", "f8", (2,)),
        ("vel_d", "f8", (2,)),
        ("vel_i", "f8", (2,)),
        ("climb_err", "f8"),
        ("accel_err", "f8"),
        ("throttle_i", "f8"),
        ("throttle", "f8"),
        ("rate_last", "f8", (3,)),
        ("rate_d", "f8", (2,)),
        ("rate_i", "f8", (3,)),
        ("yaw_err", "f8"),
        ("tilt_target", "f8"),
        ("tilt_error", "f8"),
        # landing detector
        ("land_accel", "f8", (3,)),
        ("land_s", "f8"),
        ("crash_s", "f8"),
        # landing on a failsafe
        ("pause_s", "f8"),  # hold the height for so long before the descent
        ("blind", "i8"),  # without a position: level, drifting with the wind
    ]
)


class Control(IntEnum):
    """What the array side is doing with an aircraft."""

    OFF = 0
    """Motors stopped."""
    IDLE = 1
    """Armed on the ground, motors at spin-arm."""
    TAKEOFF = 2
    LEG = 3
    """Along a straight leg, then holding its end."""
    POSITION = 4
    """To `target_pos`, which itself moves with `target_vel`."""
    VELOCITY = 5
    """At `target_vel`; zero stops and holds."""
    LAND = 6


class Flag(IntFlag):
    """What happened on the array side that a mode wants to know."""

    LIFTED = 1
    CLIMBED = 2
    """Take-off altitude reached."""
    ARRIVED = 4
    """The leg is done."""
    LANDED = 8
    CRASHED = 16
    """Far from the attitude asked for, for too long."""


def zeros(dtype: np.dtype[Any], count: int) -> Records:
    """Rows of a layout, all zero, attitudes level."""
    rows = np.zeros(count, dtype=dtype)
    if dtype == ESTIMATE:
        rows["quat"][:, 0] = 1.0
        healthy(rows)
    return rows


def healthy(estimate: Records) -> None:
    """What a good receiver, a settled estimator and a full battery say."""
    estimate["status"] = 1 | 2 | 4 | 8 | 16 | 32 | 64 | 256 | 512
    estimate["gnss_fix"] = 6
    estimate["gnss_sats"] = 10
    estimate["gnss_hdop"] = 1.21
    estimate["battery_v"] = 12.6
    estimate["compass"] = (0.0, 0.25, -0.4)
