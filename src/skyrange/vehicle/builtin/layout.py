"""What state does the array side keep of each aircraft? Record layouts: estimate, flight, gains, and legs.

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

from skyrange.world.airframes import MOTORS

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
        ("gnss_acc", "f8", (3,)),  # what the receiver claims: level m, up m, speed m/s
        ("gnss_age_s", "f8"),  # since the last fix came
        ("baro_up", "f8"),
        ("compass", "f8", (3,)),  # gauss, body
        ("battery_v", "f8"),
        ("battery_a", "f8"),
        ("imu_accel", "f8", (3,)),  # m/s², body, specific force
    ]
)

_CURVE: Final[list[Any]] = [
    ("t", "f8"),  # time flown, s
    ("done", "f8"),  # distance flown, m
    ("live", "i8"),  # 0: no leg
    ("at", "i8"),  # the segment looked up last
    ("unit", "f8", (3,)),  # direction
    ("origin", "f8", (3,)),
    ("length", "f8"),
    ("speed", "f8"),  # limits along it: m/s, m/s², m/s³, m/s⁴
    ("accel", "f8"),
    ("accel_z", "f8"),
    ("jerk", "f8"),
    ("snap", "f8"),
    ("seg", "f8", (23, 5)),  # when each segment ends, with which acceleration, speed and distance, and its peak jerk
]
CURVE: Final = np.dtype(_CURVE)
"""A straight leg with jerk-limited motion along it (`scurve`)."""

_SPLINE: Final[list[Any]] = [
    ("terms", "f8", (4, 3)),  # of the cubic in time 0…1
    ("goal", "f8", (3,)),
    ("leave", "f8", (3,)),  # velocity at the end, unscaled
    ("t", "f8"),
    ("reached", "i8"),
    ("from_speed", "f8"),  # the most at the start and at the end, m/s
    ("to_speed", "f8"),
]
SPLINE: Final = np.dtype(_SPLINE)
"""A curved leg (`spline`)."""

LEGS: Final = np.dtype(
    [
        ("curved", "i8"),  # this leg is the spline
        ("next_curved", "i8"),
        ("fast", "i8"),  # another leg follows without a stop
        ("reached", "i8"),
        ("origin", "f8", (3,)),
        ("goal", "f8", (3,)),
        ("tail", _CURVE),  # the leg before, which fades out in a corner
        ("leg", _CURVE),
        ("next", _CURVE),
        ("spline", _SPLINE),
        ("spline_next", _SPLINE),
    ]
)
"""What an aircraft on its way to a waypoint flies along."""

FLIGHT: Final = np.dtype(
    [
        # what every turn of the loop touches, side by side
        ("control", "i8"),  # a Control
        ("landed", "i8"),
        ("flags", "i8"),  # Flags raised by the loop
        ("spool", "f8"),  # motors, 0 standing … 1 spun up: part of MOT_SPIN_MIN
        ("slow_s", "f8"),  # time since guidance and position control last ran
        ("climb_accel", "f8"),  # m/s², what the vertical loop asks for
        ("accel_err", "f8"),
        ("throttle_i", "f8"),
        ("throttle", "f8"),
        ("throttle_full", "i8"),  # the mixer had to hold thrust back
        ("tilt_half2", "f8"),  # the squared sine of half of it, at the loop's rate
        ("rates_only", "i8"),
        ("att", "f8", (4,)),  # the shaped attitude target and its rates
        ("att_rate", "f8", (3,)),
        ("target_rate", "f8", (3,)),  # rates asked of the rate controllers, filtered
        ("rate_err", "f8", (3,)),
        ("rate_d", "f8", (2,)),
        ("rate_i", "f8", (3,)),
        # what guidance, position control and the modes touch
        ("armed", "i8"),
        ("seen", "i8"),  # of them, those already acted on
        # the reference, which control follows
        ("ref_pos", "f8", (3,)),
        ("ref_vel", "f8", (3,)),
        ("ref_acc", "f8", (3,)),
        # what the reference moves to
        ("target_pos", "f8", (3,)),
        ("target_vel", "f8", (3,)),
        ("target_acc", "f8", (3,)),
        ("ground", "f8"),  # height of the take-off point above the origin, m
        # limits in force
        ("speed_xy", "f8"),
        ("speed_up", "f8"),
        ("speed_down", "f8"),
        ("accel_xy", "f8"),
        ("accel_z", "f8"),
        # along legs
        ("replan", "i8"),  # the speed changed
        ("track_lag", "f8"),  # how much slower than time the leg's reference advances, 0 … 1
        # heading: a Heading, its angle and rate, and what is left of a commanded turn
        ("heading", "i8"),
        ("target_yaw", "f8"),
        ("target_yaw_rate", "f8"),
        ("turn_left", "f8"),  # rad still to turn, positive counter-clockwise
        ("turn_rate", "f8"),
        ("roi", "f8", (3,)),
        # circle
        ("centre", "f8", (3,)),
        ("circle_radius", "f8"),
        ("circle_rate", "f8"),  # rad/s, positive clockwise as ArduPilot counts it
        ("circle_speed", "f8"),
        ("circle_angle", "f8"),  # counter-clockwise from east
        ("circle_total", "f8"),
        # a pilot's sticks: roll, pitch, yaw -1 … 1, throttle 0 … 1
        ("sticks", "f8", (4,)),
        ("zero_s", "f8"),  # how long the throttle stick has been at the bottom
        ("lean", "f8", (2,)),  # predicted lean of LOITER and its rates: roll, pitch
        ("lean_rate", "f8", (2,)),
        ("brake", "f8"),
        ("brake_s", "f8"),  # since the sticks were let go
        # attitude asked for from outside (SET_ATTITUDE_TARGET)
        ("want_quat", "f8", (4,)),
        ("want_rate", "f8", (3,)),
        ("want_climb", "f8"),
        # controllers' memory
        ("pos_err", "f8", (2,)),
        ("limit", "f8", (2,)),  # the acceleration asked for where the lean limit cut it, else 0
        ("vel_err", "f8", (2,)),
        ("vel_d", "f8", (2,)),
        ("vel_i", "f8", (2,)),
        ("climb_err", "f8"),
        ("tilt_cos", "f8"),  # of the lean asked for, and that lean
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

GAINS: Final = np.dtype(
    [
        ("angle_p", "f8", (3,)),
        ("angle_accel", "f8", (3,)),
        ("angle_linear", "f8", (3,)),  # error up to which the angle controller is linear
        ("yaw_error_max", "f8"),
        ("rate_p", "f8", (3,)),
        ("rate_i", "f8", (3,)),
        ("rate_d", "f8", (2,)),
        ("rate_imax", "f8", (3,)),
        ("target_share", "f8", (3,)),  # first-order filters: the share of the new value in a step
        ("error_share", "f8", (3,)),
        ("d_share", "f8", (2,)),
        ("accel_share", "f8"),
        ("vel_share", "f8"),  # those of position control, in its own steps
        ("vel_d_share", "f8"),
        ("climb_share", "f8"),
        ("lean_accel", "f8"),  # m/s², of the largest lean
        ("pos_p", "f8"),
        ("vel_p", "f8"),
        ("vel_i", "f8"),
        ("vel_d", "f8"),
        ("vel_imax", "f8"),
        ("height_p", "f8"),
        ("climb_p", "f8"),
        ("input_p", "f8"),  # 1/s, how fast attitude targets are taken
        ("accel_max", "f8", (3,)),  # rad/s², of attitude targets
        ("slew", "f8"),  # rad/s, of the yaw
        ("accel_p", "f8"),
        ("accel_i", "f8"),
        ("accel_imax", "f8"),
        ("hover", "f8"),
        ("spin_min", "f8"),
        ("spin_range", "f8"),
        ("expo_a", "f8"),  # command = sqrt(expo_a + expo_b * thrust) - expo_c, or thrust where expo is 0
        ("expo_b", "f8"),
        ("expo_c", "f8"),
        ("expo", "f8"),
        ("roll", "f8", (MOTORS,)),  # share of each motor in roll, pitch, yaw
        ("pitch", "f8", (MOTORS,)),
        ("yaw", "f8", (MOTORS,)),
    ]
)
"""Parameters as the fast loop wants them (`gains`)."""


class Control(IntEnum):
    """What the array side is doing with an aircraft."""

    OFF = 0
    """Motors stopped."""
    IDLE = 1
    """Armed on the ground, motors at spin-arm."""
    TAKEOFF = 2
    """Up to the height of `target_pos` and staying there, at no place of the map (`_AutoTakeoff::run`)."""
    LEG = 3
    """Along the legs to a waypoint, then holding it."""
    POSITION = 4
    """To `target_pos`, which stands still."""
    VELOCITY = 5
    """At `target_vel`, with `target_acc`; zero stops and holds."""
    LAND = 6
    TRACK = 7
    """To `target_pos`, which moves with `target_vel` and `target_acc` is added."""
    ACCEL = 8
    """With `target_acc`."""
    CIRCLE = 9
    ALTITUDE = 10
    """Holding the place, to the height of `target_pos`."""
    ATTITUDE = 11
    """As `want_quat`, `want_rate` and `want_climb` say."""
    STABILIZE = 12
    """By a pilot's sticks: lean angles and throttle."""
    ALT_HOLD = 13
    """Lean angles and climb rate."""
    LOITER = 14
    """Accelerations and climb rate; stops and holds when the sticks are let go."""


class Heading(IntEnum):
    """Where the nose goes (ArduCopter/autoyaw.cpp)."""

    HOLD = 0
    NEXT = 1
    """Along the velocity of the reference."""
    ROI = 2
    FIXED = 3
    """A turn that was asked for."""
    AHEAD = 4
    """Along the velocity over the ground."""
    ANGLE_RATE = 5
    RATE = 6
    CIRCLE = 7
    """Towards the circle's centre."""


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
    LEVELLED = 32
    """The height of ALTITUDE is reached."""


def zeros(dtype: np.dtype[Any], count: int) -> Records:
    """Rows of a layout, all zero, attitudes level."""
    rows = np.zeros(count, dtype=dtype)
    if dtype == ESTIMATE:
        rows["quat"][:, 0] = 1.0
        healthy(rows)
    if dtype == FLIGHT:
        rows["att"][:, 0] = 1.0
        rows["want_quat"][:, 0] = 1.0
        rows["slow_s"] = 1e9  # work everything out in the first turn
    return rows


def healthy(estimate: Records) -> None:
    """What a good receiver, a settled estimator and a full battery say."""
    estimate["status"] = 1 | 2 | 4 | 8 | 16 | 32 | 64 | 256 | 512
    estimate["gnss_fix"] = 6
    estimate["gnss_sats"] = 10
    estimate["gnss_hdop"] = 1.21
    estimate["battery_v"] = 12.6
    estimate["compass"] = (0.0, 0.25, -0.4)
