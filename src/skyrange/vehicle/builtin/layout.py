"""Record layouts of an aircraft's state: estimate, flight, gains, legs between waypoints, battery, fence and checks.

The compiled functions read and write one record per aircraft; no value in a row depends on another row. Local frame
east-north-up from the origin, body frame forward-left-up, angles in radians counter-clockwise from east, SI units.
`ESTIMATE` is the interface of the estimator: control and telemetry know the aircraft's state from it alone.

Record layouts of the checks: battery state, fence state, and the state of failsafes and pre-arm checks. One record per
aircraft, like the others. Times are nanoseconds of simulated time, 0 for never. Telemetry reads `BATTERY_STATE`
and `FENCE_STATE`; `CHECK_STATE.prearm_ok` is SYS_STATUS's MAV_SYS_STATUS_PREARM_CHECK.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Any, Final

import numpy as np

from skyrange.world.airframes import MOTORS

Records = Any
"""A structured array, one record per aircraft. `Any`, because a type checker knows nothing of its fields."""

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
        ("height", "f8"),  # m above the ground
        # the estimator's status, as EKF_STATUS_REPORT carries it
        ("status", "i8"),  # MAVLink's EKF_STATUS_FLAGS
        ("vel_ratio", "f8"),  # normalised innovations: above 1 is outside the gate
        ("pos_ratio", "f8"),
        ("hgt_ratio", "f8"),
        ("mag_ratio", "f8"),
        ("dead_reckoning", "i8"),  # 1 while horizontal aiding is lost and position is extrapolated
        ("resets", "i8"),  # horizontal position resets so far
        ("yaw_reset", "i8"),  # 1: a reset of the yaw is requested (ahrs.request_yaw_reset)
        # the last sensor readings; GNSS fields are the receiver's, not the estimate's
        ("gnss_fix", "i8"),  # MAVLink's GPS_FIX_TYPE
        ("gnss_sats", "i8"),
        ("gnss_hdop", "f8"),
        ("gnss_pos", "f8", (3,)),
        ("gnss_vel", "f8", (3,)),
        ("gnss_acc", "f8", (3,)),  # accuracy stated by the receiver: horizontal m, vertical m, speed m/s
        ("gnss_age_s", "f8"),  # since the last fix arrived
        ("baro_up", "f8"),
        ("compass", "f8", (3,)),  # gauss, body
        ("battery_v", "f8"),
        ("battery_a", "f8"),
        ("imu_accel", "f8", (3,)),  # m/s², body, specific force
    ]
)

_SCURVE: Final[list[Any]] = [
    ("t", "f8"),  # time flown, s
    ("done", "f8"),  # distance flown, m
    ("active", "i8"),  # 0: no leg is set
    ("segment", "i8"),  # index of the segment looked up last
    ("unit", "f8", (3,)),  # direction
    ("origin", "f8", (3,)),
    ("length", "f8"),
    ("speed", "f8"),  # limits along it: m/s, m/s², m/s³, m/s⁴
    ("accel", "f8"),
    ("accel_z", "f8"),
    ("jerk", "f8"),
    ("snap", "f8"),
    ("seg", "f8", (23, 5)),  # per segment: end time; acceleration, speed and distance then; peak jerk
]
SCURVE: Final = np.dtype(_SCURVE)
"""A straight leg with jerk-limited motion along it (`guidance.scurve`)."""

_SPLINE: Final[list[Any]] = [
    ("terms", "f8", (4, 3)),  # of the cubic in time 0…1
    ("goal", "f8", (3,)),
    ("leave", "f8", (3,)),  # velocity at the end, unscaled
    ("t", "f8"),
    ("reached", "i8"),
    ("from_speed", "f8"),  # speed limits at the start and at the end, m/s
    ("to_speed", "f8"),
]
SPLINE: Final = np.dtype(_SPLINE)
"""A curved leg (`guidance.spline`)."""

LEGS: Final = np.dtype(
    [
        ("this_leg_is_spline", "i8"),  # 1: this leg is the spline
        ("next_leg_is_spline", "i8"),
        ("fast_waypoint", "i8"),  # 1: another leg follows without a stop
        ("reached_destination", "i8"),
        ("origin", "f8", (3,)),
        ("destination", "f8", (3,)),
        ("prev_leg", _SCURVE),  # the previous leg, whose end is blended into a corner
        ("this_leg", _SCURVE),
        ("next_leg", _SCURVE),
        ("this_spline", _SPLINE),
        ("next_spline", _SPLINE),
    ]
)
"""The legs of an aircraft on its way to a waypoint (AC_WPNav)."""

FLIGHT: Final = np.dtype(
    [
        # used in every pass of the loop; kept together for the cache
        ("control", "i8"),  # a Control
        ("landed", "i8"),
        ("flags", "i8"),  # FlightEvents raised by the loop
        ("spool_state", "f8"),  # motor spool state, 0 stopped … 1 spooled up: share of MOT_SPIN_MIN
        ("arming_delay_s", "f8"),  # time for which the motors stay stopped after arming, s
        ("since_slow_s", "f8"),  # time since guidance and position control last ran, s
        ("climb_accel", "f8"),  # m/s², output of the climb rate controller
        ("accel_err", "f8"),
        ("throttle_i", "f8"),
        ("throttle", "f8"),
        ("throttle_limited", "i8"),  # 1: the mixer had to reduce thrust (motors.limit.throttle_upper)
        ("tilt_half2", "f8"),  # squared sine of half the thrust angle error, in every pass
        ("rates_only", "i8"),
        ("att_target", "f8", (4,)),  # shaped attitude target and its rates
        ("att_target_rate", "f8", (3,)),
        ("target_rate", "f8", (3,)),  # filtered targets of the rate controllers
        ("rate_err", "f8", (3,)),
        ("rate_d", "f8", (2,)),
        ("rate_i", "f8", (3,)),
        # used by guidance, position control and the modes
        ("armed", "i8"),
        ("handled_flags", "i8"),  # events in `flags` that were handled
        # the reference, which position control follows (AC_PosControl `_pos_desired`)
        ("ref_pos", "f8", (3,)),
        ("ref_vel", "f8", (3,)),
        ("ref_acc", "f8", (3,)),
        # the target, which the reference approaches
        ("target_pos", "f8", (3,)),
        ("target_vel", "f8", (3,)),
        ("target_acc", "f8", (3,)),
        ("ground", "f8"),  # height of the take-off point above the origin, m
        # speed and acceleration limits in force
        ("speed_xy", "f8"),
        ("speed_up", "f8"),
        ("speed_down", "f8"),
        ("accel_xy", "f8"),
        ("accel_z", "f8"),
        # along legs
        ("speed_changed", "i8"),  # 1: the speed limit changed
        ("track_lag", "f8"),  # 1 minus AC_WPNav's `_track_dt_scalar`: how much the reference lags, 0 … 1
        # yaw: an AutoYawMode, its angle and rate, and the rest of a commanded turn
        ("auto_yaw_mode", "i8"),
        ("target_yaw", "f8"),
        ("target_yaw_rate", "f8"),
        ("fixed_yaw_offset", "f8"),  # rad that remain to be turned, positive counter-clockwise
        ("fixed_yaw_slewrate", "f8"),
        ("roi", "f8", (3,)),
        # circle
        ("centre", "f8", (3,)),
        ("circle_radius", "f8"),
        ("circle_rate", "f8"),  # rad/s, positive clockwise as ArduPilot counts it
        ("circle_ang_vel", "f8"),
        ("circle_angle", "f8"),  # counter-clockwise from east
        ("circle_angle_total", "f8"),
        # the pilot's sticks: roll, pitch, yaw -1 … 1, throttle 0 … 1
        ("sticks", "f8", (4,)),
        ("throttle_zero_s", "f8"),  # how long the throttle stick has been at the bottom, s
        ("predicted_lean", "f8", (2,)),  # predicted lean angles of LOITER and their rates: roll, pitch
        ("predicted_lean_rate", "f8", (2,)),
        ("brake_accel", "f8"),
        ("brake_timer_s", "f8"),  # since the sticks were released, s
        # target of SET_ATTITUDE_TARGET
        ("guided_quat", "f8", (4,)),
        ("guided_ang_vel", "f8", (3,)),
        ("guided_climb_rate", "f8"),
        # controller states
        ("pos_err", "f8", (2,)),
        ("limited_accel", "f8", (2,)),  # requested acceleration where the lean limit reduced it, else 0
        ("vel_err", "f8", (2,)),
        ("vel_d", "f8", (2,)),
        ("vel_i", "f8", (2,)),
        ("climb_err", "f8"),
        ("tilt_cos", "f8"),  # cosine of the requested lean angle, and that angle
        ("tilt_target", "f8"),
        ("tilt_error", "f8"),
        # landing detector
        ("land_accel", "f8", (3,)),
        ("land_s", "f8"),
        ("crash_s", "f8"),
        ("land_datum", "f8"),  # height above the ground from which a landing counts its height, m
        # LAND after a failsafe
        ("land_delay_s", "f8"),  # time to hold the height before the descent, s
        ("land_nogps", "i8"),  # 1: land without a position, level, drifting with the wind
    ]
)

GAINS: Final = np.dtype(
    [
        ("angle_p", "f8", (3,)),
        ("angle_accel", "f8", (3,)),
        ("angle_linear", "f8", (3,)),  # error up to which the angle controller is linear, rad
        ("yaw_error_max", "f8"),
        ("rate_p", "f8", (3,)),
        ("rate_i", "f8", (3,)),
        ("rate_d", "f8", (2,)),
        ("rate_imax", "f8", (3,)),
        ("target_alpha", "f8", (3,)),  # low-pass filters: weight of the new value in one step
        ("error_alpha", "f8", (3,)),
        ("d_alpha", "f8", (2,)),
        ("accel_alpha", "f8"),
        ("vel_alpha", "f8"),  # of position control, for its own step
        ("vel_d_alpha", "f8"),
        ("climb_alpha", "f8"),
        ("lean_accel", "f8"),  # m/s², at the largest lean angle
        ("pos_p", "f8"),
        ("vel_p", "f8"),
        ("vel_i", "f8"),
        ("vel_d", "f8"),
        ("vel_imax", "f8"),
        ("height_p", "f8"),
        ("climb_p", "f8"),
        ("input_p", "f8"),  # 1/s, inverse of ATC_INPUT_TC
        ("accel_max", "f8", (3,)),  # rad/s², of attitude targets
        ("slew_yaw", "f8"),  # rad/s, of the yaw
        ("accel_p", "f8"),
        ("accel_i", "f8"),
        ("accel_imax", "f8"),
        ("throttle_hover", "f8"),
        ("spin_min", "f8"),
        ("spin_range", "f8"),
        ("expo_a", "f8"),  # command = sqrt(expo_a + expo_b * thrust) - expo_c, or thrust where expo is 0
        ("expo_b", "f8"),
        ("expo_c", "f8"),
        ("expo", "f8"),
        ("roll_factor", "f8", (MOTORS,)),  # factor of each motor in roll, pitch, yaw
        ("pitch_factor", "f8", (MOTORS,)),
        ("yaw_factor", "f8", (MOTORS,)),
    ]
)
"""Parameters in the form that the loop uses (`control.gains`)."""


class ControlMode(IntEnum):
    """What the control loop does with an aircraft: ArduCopter's sub-modes, one number for all modes."""

    OFF = 0
    """Motors stopped."""
    IDLE = 1
    """Armed on the ground, motors at spin-arm."""
    TAKEOFF = 2
    """Climb to the height of `target_pos` and stay there, without holding a position (`_AutoTakeoff::run`)."""
    LEG = 3
    """Fly the legs to a waypoint, then hold it."""
    POSITION = 4
    """Fly to `target_pos`, which does not move."""
    VELOCITY = 5
    """Fly at `target_vel` with `target_acc`; zero velocity stops and holds."""
    LAND = 6
    POS_VEL_ACCEL = 7
    """Fly to `target_pos`, which moves with `target_vel`; `target_acc` is added."""
    ACCEL = 8
    """Fly with `target_acc`."""
    CIRCLE = 9
    LOITER_TO_ALT = 10
    """Hold the position and go to the height of `target_pos`."""
    ATTITUDE = 11
    """Follow the attitude, body rates and climb rate set by SET_ATTITUDE_TARGET."""
    STABILIZE = 12
    """Follow the pilot's sticks: lean angles and throttle."""
    ALT_HOLD = 13
    """Follow the pilot's sticks: lean angles and climb rate."""
    LOITER = 14
    """Follow the pilot's sticks: accelerations and climb rate; stop and hold when the sticks are released."""


class AutoYawMode(IntEnum):
    """How the yaw target is chosen (ArduCopter/autoyaw.cpp `AutoYaw::Mode`)."""

    HOLD = 0
    LOOK_AT_NEXT_WP = 1
    """Along the velocity of the reference."""
    ROI = 2
    FIXED = 3
    """A commanded turn."""
    LOOK_AHEAD = 4
    """Along the velocity over the ground."""
    ANGLE_RATE = 5
    RATE = 6
    CIRCLE = 7
    """Towards the circle's centre."""


class FlightEvent(IntFlag):
    """Events that the control loop reports to modes and missions."""

    LIFT_OFF = 1
    TAKEOFF_COMPLETE = 2
    """The take-off altitude is reached."""
    DESTINATION_REACHED = 4
    """The destination of the leg is reached."""
    LAND_COMPLETE = 8
    CRASH = 16
    """The attitude error has been too large for too long."""
    ALTITUDE_REACHED = 32
    """The height of `ControlMode.LOITER_TO_ALT` is reached."""


def new_records(dtype: np.dtype[Any], count: int) -> Records:
    """Return `count` records of a layout, all zero, with level attitudes."""
    rows = np.zeros(count, dtype=dtype)
    if dtype == ESTIMATE:
        rows["quat"][:, 0] = 1.0
        set_healthy(rows)
    if dtype == FLIGHT:
        rows["att_target"][:, 0] = 1.0
        rows["guided_quat"][:, 0] = 1.0
        rows["since_slow_s"] = 1e9  # run guidance and position control in the first pass
    return rows


def set_healthy(estimate: Records) -> None:
    """Fill in the values of a good receiver, a converged estimator and a full battery."""
    estimate["status"] = 1 | 2 | 4 | 8 | 16 | 32 | 64 | 256 | 512
    estimate["gnss_fix"] = 6
    estimate["gnss_sats"] = 10
    estimate["gnss_hdop"] = 1.21
    estimate["battery_v"] = 12.6
    estimate["compass"] = (0.0, 0.25, -0.4)


NO_PRIORITY: Final = 127
"""`BATTERY_STATE.priority` before any battery failsafe: lower than every action (AP_BattMonitor's INT8_MAX)."""

BATTERY_STATE: Final = np.dtype(
    [
        ("voltage", "f8"),  # V
        ("current", "f8"),  # A
        ("resting_v", "f8"),  # V, estimated without the sag; never below the voltage
        ("consumed_mah", "f8"),
        ("consumed_wh", "f8"),
        ("remaining_pct", "i8"),  # of BATT_CAPACITY; -1 unknown
        ("level", "i8"),  # 0 none, 1 unhealthy, 2 low, 3 critical (AP_BattMonitor::Failsafe)
        ("pending_level", "i8"),  # the level found by the check; `level` follows when it is acted upon
        ("low_ns", "i8"),  # when the voltage became low
        ("critical_ns", "i8"),
        ("priority", "i8"),  # the highest priority of a failsafe action so far; smaller is higher
        ("failsafe_triggered", "i8"),  # 1 after a battery failsafe
        # estimate of the internal resistance
        ("resistance", "f8"),  # ohm
        ("current_max_a", "f8"),
        ("voltage_filt", "f8"),
        ("current_filt_a", "f8"),
        ("reference_v", "f8"),
        ("reference_a", "f8"),
    ]
)
"""After AP_BattMonitor.h `BattMonitor_State` and AP_BattMonitor_Backend.h."""

FENCE_STATE: Final = np.dtype(
    [
        ("enabled", "i8"),  # types in force: 1 maximum altitude, 2 circle around home, 4 polygons, 8 minimum altitude
        ("breached", "i8"),  # types breached now
        ("new_breaches", "i8"),  # types newly breached at this check
        ("auto_disabled", "i8"),  # types disabled at this check for landing
        ("alt_min_enabled", "i8"),  # 1: the minimum altitude was enabled at this check
        ("count", "i8"),  # number of breaches
        ("breach_ns", "i8"),
        ("status_sent_ns", "i8"),  # when FENCE_STATUS was last sent for a breach
        ("recovery_ns", "i8"),  # when a mode was last chosen during a breach (manual recovery)
        ("alt_min_state", "i8"),  # minimum altitude: 0 by parameters, 1 enabled manually, 2 disabled manually
        ("last_enable", "i8"),  # FENCE_ENABLE and FENCE_AUTOENABLE at the last check
        ("last_auto_enable", "i8"),
        # where a further breach is recorded; 0 none
        ("backup_max_m", "f8"),
        ("backup_min_m", "f8"),
        ("backup_circle_m", "f8"),
        # distance outside, negative inside
        ("alt_max_breach_m", "f8"),
        ("alt_min_breach_m", "f8"),
        ("circle_breach_m", "f8"),
        ("polygon_breach_m", "f8"),
    ]
)
"""After AC_Fence.h; fence types are bits of `fence.FenceType`."""

MAX_FENCE_ITEMS: Final = 70
"""Points of all zones together: (48 + 256 + 256) / 8 bytes (StorageManager.cpp StorageFence, 15 areas; `max_items`)."""

POLYGON_IN: Final = 1
POLYGON_OUT: Final = 2
CIRCLE_IN: Final = 3
CIRCLE_OUT: Final = 4

ZONES: Final = np.dtype(
    [
        ("count", "i8"),  # number of zones
        ("min_circle_radius", "f8"),  # m, radius of the smallest inclusion circle; 0 none
        ("kind", "i8", (MAX_FENCE_ITEMS,)),  # per zone: one of the constants above
        ("first", "i8", (MAX_FENCE_ITEMS,)),  # index of its first point
        ("size", "i8", (MAX_FENCE_ITEMS,)),  # number of its points
        ("radius", "f8", (MAX_FENCE_ITEMS,)),  # m, of circles
        ("point", "f8", (MAX_FENCE_ITEMS, 2)),  # east, north, m
    ]
)
"""Zones of a fence: its polygons and circles, local metres."""

CHECK_STATE: Final = np.dtype(
    [
        ("alarms", "i8"),  # Alarms of the last check
        ("home", "f8", (3,)),  # m
        ("located", "i8"),  # 1 after the first valid position: home is set
        # ground station
        ("gcs_heard_ns", "i8"),  # time of its last heartbeat
        ("gcs_lost", "i8"),
        # estimator
        ("ekf_count", "i8"),
        ("ekf_passed", "i8"),  # 1 after the first passed check
        ("ekf_bad", "i8"),
        ("ekf_failsafe", "i8"),  # 1: the failsafe is active
        ("ekf_reported", "i8"),  # 1: it was raised while armed, so its end is reported
        ("ekf_warned_ns", "i8"),
        ("vel_ratio_filt", "f8"),  # filtered ratios
        ("pos_ratio_filt", "f8"),
        ("glitching", "i8"),
        # dead reckoning
        ("dr_active", "i8"),
        ("dr_started_ns", "i8"),
        ("dr_timed_out", "i8"),  # 1: for longer than FS_DR_TIMEOUT
        ("dr_failsafe", "i8"),  # 1: the failsafe is active
        ("thrust_ns", "i8"),  # since when full thrust does not stop the descent
        # pre-arm checks
        ("prearm_ok", "i8"),
        ("prearm_urgent", "i8"),  # 1: report soon, they have just begun to fail
        ("prearm_reported_ns", "i8"),
        # Remote ID transmitter
        ("rid_ns", "i8"),  # time of its last OPEN_DRONE_ID_ARM_STATUS
        ("rid_status", "i8"),  # MAV_ODID_ARM_STATUS
        ("rid_id_type", "i8"),  # id type of the last OPEN_DRONE_ID_BASIC_ID; 0 none
        ("rid_operator", "i8"),  # 1: it has an operator location
        ("rid_system_ns", "i8"),  # time of its last OPEN_DRONE_ID_SYSTEM, or of a _SYSTEM_UPDATE after one
        ("armed_up_m", "f8"),  # height at the last arming
        ("crashed", "i8"),  # 1: disarmed for a crash and not armed again
    ]
)
