"""Parameter table: ArduCopter's names, units, ranges and defaults, and the values that an aircraft holds.

Only parameters with an effect are listed. Names and units are those of ArduCopter 4.6 (centimetres where it has
centimetres); defaults are from its sources: libraries/AC_AttitudeControl (AC_PosControl.cpp,
AC_AttitudeControl_Multi.h), libraries/AC_WPNav/AC_WPNav.cpp, libraries/AP_Motors, ArduCopter/config.h. The names of
other versions are in `parameters.renames`.

An aircraft's parameters are kept twice. `Fleet.stored_params` has the values as written, as ArduCopter's storage does:
any number of the type. In effect is that number limited to its range, so that no value can make the arithmetic fail: in
the record `SETTINGS` for compiled functions, through `Fleet.param` for the rest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.vehicle.builtin.layout import Records
from skyrange.vehicle.builtin.parameters.renames import canonical_name, from_canonical, to_canonical
from skyrange.world.airframes import Airframe

_REAL32 = dialect.MAV_PARAM_TYPE_REAL32
_INT8 = dialect.MAV_PARAM_TYPE_INT8
_INT16 = dialect.MAV_PARAM_TYPE_INT16
_INT32 = dialect.MAV_PARAM_TYPE_INT32


class Parameter(NamedTuple):
    """One parameter: default and range in ArduCopter's unit, which `meaning` names; `kind` is a MAV_PARAM_TYPE.

    `reboot` means that a new value takes effect at the next boot, as in ArduCopter's metadata (@RebootRequired).
    """

    name: str
    default: float
    low: float
    high: float
    meaning: str
    kind: int = _REAL32
    reboot: bool = False


def stream_rates(prefix: str) -> tuple[Parameter, ...]:
    """Return the stream rate parameters of one telemetry channel (GCS_MAVLink_Parameters.cpp)."""
    return tuple(
        Parameter(prefix + name, 0, 0, 50, f"boot rate of {what}, Hz", _INT16, reboot=True)
        for name, what in _STREAMS.items()
    )


_STREAMS: Final = {
    "ADSB": "other aircraft's positions (none is sent)",
    "EXT_STAT": "status messages",
    "EXTRA1": "ATTITUDE, AHRS2 and speed controllers",
    "EXTRA2": "VFR_HUD",
    "EXTRA3": "estimator, battery and environment",
    "PARAMS": "parameters (no message is streamed)",
    "POSITION": "position messages",
    "RAW_CTRL": "raw control (no message is streamed)",
    "RAW_SENS": "sensor readings",
    "RC_CHAN": "motor outputs and radio channels",
}
PARAMETERS: Final = tuple(
    sorted(
        (
            Parameter("ANGLE_MAX", 3000, 1000, 8000, "largest lean angle, cdeg", _INT16),
            Parameter("ATC_ACCEL_R_MAX", 110000, 1000, 180000, "roll acceleration limit, cdeg/s²"),
            Parameter("ATC_ACCEL_P_MAX", 110000, 1000, 180000, "pitch acceleration limit, cdeg/s²"),
            Parameter("ATC_ACCEL_Y_MAX", 27000, 1000, 72000, "yaw acceleration limit, cdeg/s²"),
            Parameter("ATC_INPUT_TC", 0.15, 0, 1, "time constant of attitude inputs, s"),
            Parameter("ATC_ANG_RLL_P", 4.5, 1, 12, "roll angle gain, 1/s"),
            Parameter("ATC_ANG_PIT_P", 4.5, 1, 12, "pitch angle gain, 1/s"),
            Parameter("ATC_ANG_YAW_P", 4.5, 1, 12, "yaw angle gain, 1/s"),
            Parameter("ATC_RAT_RLL_P", 0.135, 0.01, 5, "roll rate gain"),
            Parameter("ATC_RAT_RLL_I", 0.135, 0, 5, "roll rate integral gain"),
            Parameter("ATC_RAT_RLL_D", 0.0036, 0, 0.1, "roll rate derivative gain"),
            Parameter("ATC_RAT_RLL_IMAX", 0.5, 0, 1, "roll rate integral limit"),
            Parameter("ATC_RAT_RLL_FLTT", 20, 0, 200, "roll rate target filter, Hz; 0 none"),
            Parameter("ATC_RAT_RLL_FLTE", 0, 0, 200, "roll rate error filter, Hz; 0 none"),
            Parameter("ATC_RAT_RLL_FLTD", 20, 1, 200, "roll rate derivative filter, Hz"),
            Parameter("ATC_RAT_PIT_P", 0.135, 0.01, 5, "pitch rate gain"),
            Parameter("ATC_RAT_PIT_I", 0.135, 0, 5, "pitch rate integral gain"),
            Parameter("ATC_RAT_PIT_D", 0.0036, 0, 0.1, "pitch rate derivative gain"),
            Parameter("ATC_RAT_PIT_IMAX", 0.5, 0, 1, "pitch rate integral limit"),
            Parameter("ATC_RAT_PIT_FLTT", 20, 0, 200, "pitch rate target filter, Hz; 0 none"),
            Parameter("ATC_RAT_PIT_FLTE", 0, 0, 200, "pitch rate error filter, Hz; 0 none"),
            Parameter("ATC_RAT_PIT_FLTD", 20, 1, 200, "pitch rate derivative filter, Hz"),
            Parameter("ATC_RAT_YAW_P", 0.18, 0.01, 5, "yaw rate gain"),
            Parameter("ATC_RAT_YAW_I", 0.018, 0, 5, "yaw rate integral gain"),
            Parameter("ATC_RAT_YAW_IMAX", 0.5, 0, 1, "yaw rate integral limit"),
            Parameter("ATC_RAT_YAW_FLTT", 20, 0, 200, "yaw rate target filter, Hz; 0 none"),
            Parameter("ATC_RAT_YAW_FLTE", 2.5, 0.5, 100, "yaw rate error filter, Hz"),
            Parameter("ATC_SLEW_YAW", 6000, 500, 18000, "largest requested yaw rate, cdeg/s"),
            Parameter(
                "AUTO_OPTIONS", 0, 0, 255, "bit 0: arm in AUTO; bit 1: take off in AUTO without raised throttle", _INT32
            ),
            Parameter("CIRCLE_OPTIONS", 1, 0, 15, "bit 1: face along the circle instead of its centre", _INT16),
            Parameter("CIRCLE_RADIUS", 1000, 0, 200000, "radius of circles without one of their own, cm"),
            Parameter("CIRCLE_RATE", 20, -90, 90, "turn rate of circles, deg/s"),
            Parameter("GUID_OPTIONS", 0, 0, 255, "bit 6: fly positions in GUIDED as waypoints", _INT32),
            Parameter(
                "ARMING_CHECK",
                1,
                0,
                1048575,
                "pre-arm checks: bit 0 all; 1 barometer, 2 compass, 3 GNSS, 4 inertial, 7, 8 battery, 14 mission",
                _INT32,
            ),
            Parameter(
                "ARMING_MIS_ITEMS",
                0,
                0,
                127,
                "items a mission must have: bit 0 LAND, 2 DO_LAND_START, 3 TAKEOFF, 5 a rally point, 6 RTL",
                _INT32,
            ),
            Parameter("ARMING_OPTIONS", 0, 0, 1, "bit 0: do not report failing pre-arm checks every 30 s", _INT32),
            Parameter("BATT_ARM_MAH", 0, 0, 200000, "minimum charge for arming, mAh; 0 none", _INT32),
            Parameter("BATT_ARM_VOLT", 0, 0, 120, "minimum voltage for arming, V; 0 none"),
            Parameter("BATT_CAPACITY", 3300, 0, 200000, "full charge, mAh", _INT32),
            Parameter("BATT_CRT_MAH", 0, 0, 200000, "critical charge left, mAh; 0 none"),
            Parameter("BATT_CRT_VOLT", 0, 0, 120, "critical voltage, V; 0 none"),
            Parameter(
                "BATT_FS_CRT_ACT",
                0,
                0,
                7,
                "on critical: 0 report, 1, 4 LAND, 2, 3 RTL, 5 motors off, 6 AUTO_RTL, 7 BRAKE",
                _INT8,
            ),
            Parameter("BATT_FS_LOW_ACT", 0, 0, 7, "on low: the same", _INT8),
            Parameter("BATT_FS_VOLTSRC", 0, 0, 1, "compare the voltage as measured (0) or without the sag (1)", _INT8),
            Parameter("BATT_LOW_MAH", 0, 0, 200000, "low charge left, mAh; 0 none"),
            Parameter("BATT_LOW_TIMER", 10, 0, 120, "time before a low voltage counts, s; 0 never", _INT8),
            Parameter("BATT_LOW_VOLT", 10.5, 0, 120, "low voltage, V; 0 none"),
            Parameter("BATT_MONITOR", 4, 0, 4, "0 no battery monitor, else voltage and current", _INT8),
            Parameter("FENCE_ACTION", 1, 0, 5, "on a breach: 0 report, 1 RTL, 2 LAND, 3 RTL, 4 BRAKE, 5 LAND", _INT8),
            Parameter("FENCE_ALT_MAX", 100, 10, 1000, "maximum height above home, m"),
            Parameter("FENCE_ALT_MIN", -10, -100, 100, "minimum height above home, m"),
            Parameter("FENCE_AUTOENABLE", 0, 0, 3, "in force: 1, 2 after an automatic take-off, 3 while armed", _INT8),
            Parameter("FENCE_ENABLE", 0, 0, 1, "fence in force", _INT8),
            Parameter("FENCE_MARGIN", 2, 1, 10, "distance to keep from the fence, m"),
            Parameter(
                "FENCE_OPTIONS",
                0,
                0,
                3,
                "bit 0: no other mode until back inside; bit 1: inside any inclusion zone suffices",
                _INT16,
            ),
            Parameter("FENCE_RADIUS", 300, 30, 10000, "radius around home, m"),
            Parameter(
                "FENCE_TYPE",
                7,
                0,
                15,
                "bit 0 maximum height, 1 radius, 2 polygons and circles, 3 minimum height",
                _INT8,
            ),
            Parameter("FLIGHT_OPTIONS", 0, 0, 1, "bit 0: no thrust loss check", _INT32),
            Parameter("FS_CRASH_CHECK", 1, 0, 1, "disarm after a crash", _INT8),
            Parameter("FS_DR_ENABLE", 2, 0, 7, "on dead reckoning: 0 report, 1, 4 LAND, 2, 3 RTL, 6 AUTO_RTL", _INT8),
            Parameter("FS_DR_TIMEOUT", 30, 0, 120, "time for which dead reckoning is a valid position, s", _INT16),
            Parameter(
                "FS_EKF_ACTION", 1, 0, 3, "on a bad estimate: 0 report, 1 LAND, 2 ALT_HOLD, 3 LAND from any mode", _INT8
            ),
            Parameter("FS_EKF_FILT", 5, 0, 10, "filter of the compared ratios, Hz; 0 none"),
            Parameter("FS_EKF_THRESH", 0.8, 0, 1, "ratio of innovation to gate that is bad; 0 never"),
            Parameter(
                "FS_GCS_ENABLE",
                0,
                0,
                7,
                "on a lost ground station: 0 nothing, 1, 2, 3 RTL, 4, 5 LAND, 6 AUTO_RTL, 7 BRAKE",
                _INT8,
            ),
            Parameter("FS_GCS_TIMEOUT", 5, 2, 120, "time without heartbeats, s"),
            Parameter(
                "FS_OPTIONS",
                16,
                0,
                31,
                "continue: bit 1 in AUTO without ground station, 3 landing, 4 in a pilot's mode",
                _INT32,
            ),
            Parameter("GPS_HDOP_GOOD", 140, 100, 900, "largest HDOP for arming, 1/100", _INT16),
            Parameter("RALLY_INCL_HOME", 1, 0, 1, "treat home as a rally point", _INT8),
            Parameter("RALLY_LIMIT_KM", 0.3, 0, 1000, "ignore rally points beyond this distance, km; 0 none"),
            Parameter("DID_ENABLE", 0, 0, 1, "Remote ID by a transmitter on MAVLink", _INT8),
            Parameter("DID_OPTIONS", 0, 0, 7, "bit 0: arm only while the Remote ID transmitter is ready", _INT8),
            Parameter("DISARM_DELAY", 10, 0, 127, "time armed on the ground before disarming, s; 0 never", _INT8),
            Parameter("EK3_ABIAS_P_NSE", 0.02, 0.00001, 0.02, "accelerometer bias noise, m/s³"),
            Parameter("EK3_ACC_BIAS_LIM", 1.0, 0.5, 2.5, "largest accelerometer bias, m/s²"),
            Parameter("EK3_ACC_P_NSE", 0.35, 0.01, 1.0, "accelerometer noise, m/s²"),
            Parameter("EK3_ALT_M_NSE", 2.0, 0.1, 100.0, "barometer noise, m"),
            Parameter("EK3_CHECK_SCALE", 100, 50, 200, "scale of the receiver checks' limits, %", _INT16),
            Parameter(
                "EK3_DRAG_BCOEF_X", 0, 0, 1000, "above 0: the wind is known from drag, enables dead reckoning, kg/m²"
            ),
            Parameter("EK3_DRAG_BCOEF_Y", 0, 0, 1000, "the same along the other axis, kg/m²"),
            Parameter("EK3_GBIAS_P_NSE", 0.001, 0.00001, 0.001, "gyro bias noise, rad/s²"),
            Parameter("EK3_GLITCH_RAD", 25, 0, 100, "uncertainty at which position is reset to GNSS, m", _INT8),
            Parameter("EK3_GPS_CHECK", 31, 0, 255, "receiver checks before use, bit mask", _INT8),
            Parameter("EK3_GYRO_P_NSE", 0.015, 0.0001, 0.1, "gyro noise, rad/s"),
            Parameter("EK3_HGT_I_GATE", 500, 100, 1000, "height gate, 1/100 standard deviation", _INT16),
            Parameter("EK3_MAG_I_GATE", 300, 100, 1000, "compass gate, 1/100 standard deviation", _INT16),
            Parameter("EK3_MAG_M_NSE", 0.05, 0.01, 0.5, "compass noise, gauss"),
            Parameter("EK3_NOAID_M_NSE", 10, 0.5, 50, "noise of the position assumed without aiding, m"),
            Parameter("EK3_POS_I_GATE", 500, 100, 1000, "GNSS position gate, 1/100 standard deviation", _INT16),
            Parameter("EK3_POSNE_M_NSE", 0.5, 0.1, 10.0, "minimum GNSS position noise, m"),
            Parameter("EK3_TAU_OUTPUT", 25, 10, 50, "time constant of corrections in the output, cs", _INT8),
            Parameter("EK3_VEL_I_GATE", 500, 100, 1000, "GNSS velocity gate, 1/100 standard deviation", _INT16),
            Parameter("EK3_VELD_M_NSE", 0.5, 0.05, 5.0, "minimum GNSS climb rate noise, m/s"),
            Parameter("EK3_VELNE_M_NSE", 0.3, 0.05, 5.0, "minimum GNSS horizontal velocity noise, m/s"),
            Parameter("GUID_TIMEOUT", 3, 0.1, 5, "timeout of velocity targets in GUIDED, s"),
            Parameter("LAND_ALT_LOW", 1000, 100, 10000, "height of the final descent, cm", _INT16),
            Parameter("LAND_SPEED", 50, 30, 200, "speed of the final descent, cm/s", _INT16),
            Parameter("LAND_SPEED_HIGH", 0, 0, 500, "descent speed above LAND_ALT_LOW, cm/s; 0 WPNAV_SPEED_DN", _INT16),
            Parameter("LOIT_ACC_MAX", 500, 100, 981, "position correction of LOITER, cm/s²"),
            Parameter("LOIT_ANG_MAX", 0, 0, 45, "largest lean in LOITER, deg; 0 two thirds of ANGLE_MAX"),
            Parameter("LOIT_BRK_ACCEL", 250, 25, 250, "braking of LOITER, cm/s²"),
            Parameter("LOIT_BRK_DELAY", 1, 0, 2, "delay between releasing the sticks and braking in LOITER, s"),
            Parameter("LOIT_BRK_JERK", 500, 500, 5000, "jerk of braking in LOITER, cm/s³"),
            Parameter("LOIT_SPEED", 1250, 20, 3500, "maximum speed in LOITER, cm/s"),
            Parameter(
                "MIS_OPTIONS", 0, 0, 15, "bit 2: a mission goes on after NAV_LAND where a take-off follows", _INT16
            ),
            Parameter("MIS_RESTART", 0, 0, 1, "AUTO resumes the mission (0) or restarts it (1)", _INT8),
            Parameter("MOT_SPIN_ARM", 0.10, 0, 1, "command when armed on the ground"),
            Parameter("MOT_SPIN_MAX", 0.95, 0.5, 1, "command at full thrust"),
            Parameter("MOT_SPIN_MIN", 0.15, 0, 0.3, "command at no thrust, in flight"),
            Parameter("MOT_SPOOL_TIME", 0.5, 0.05, 2, "from ground idle to full range, s"),
            Parameter("MOT_THST_EXPO", 0.65, -1, 1, "exponent of the thrust curve that is inverted"),
            Parameter("MOT_THST_HOVER", 0.35, 0.125, 0.6875, "thrust in hover, 0 to 1"),
            Parameter("PILOT_ACCEL_Z", 250, 50, 500, "vertical acceleration in a pilot's modes, cm/s²", _INT16),
            Parameter("PILOT_SPEED_DN", 0, 0, 500, "descent speed in a pilot's modes, cm/s; 0 PILOT_SPEED_UP", _INT16),
            Parameter("PILOT_SPEED_UP", 250, 50, 500, "climb speed in a pilot's modes, cm/s", _INT16),
            Parameter("PILOT_Y_EXPO", 0, -0.5, 0.95, "exponential of the yaw stick"),
            Parameter("PILOT_Y_RATE", 202.5, 1, 360, "yaw rate of the full stick, deg/s"),
            Parameter("PSC_ACCZ_P", 0.5, 0.2, 1.5, "vertical acceleration gain, 1/1000 per cm/s²"),
            Parameter("PSC_ACCZ_I", 1.0, 0, 3, "vertical acceleration integral gain"),
            Parameter("PSC_ACCZ_IMAX", 800, 0, 1000, "vertical acceleration integral limit, 1/1000"),
            Parameter("PSC_ACCZ_FLTE", 20, 1, 100, "vertical acceleration error filter, Hz"),
            Parameter("PSC_JERK_XY", 5, 1, 20, "horizontal jerk of shaped references, m/s³"),
            Parameter("PSC_JERK_Z", 5, 1, 50, "vertical jerk of shaped references, m/s³"),
            Parameter("PSC_POSXY_P", 1, 0.5, 2, "horizontal position gain, 1/s"),
            Parameter("PSC_POSZ_P", 1, 0.5, 4, "vertical position gain, 1/s"),
            Parameter("PSC_VELXY_P", 2, 0.1, 6, "horizontal velocity gain, 1/s"),
            Parameter("PSC_VELXY_I", 1, 0, 1, "horizontal velocity integral gain, 1/s²"),
            Parameter("PSC_VELXY_D", 0.25, 0, 1, "horizontal velocity derivative gain"),
            Parameter("PSC_VELXY_IMAX", 1000, 0, 4500, "horizontal velocity integral limit, cm/s²"),
            Parameter("PSC_VELXY_FLTE", 5, 0.5, 100, "horizontal velocity error filter, Hz"),
            Parameter("PSC_VELXY_FLTD", 5, 0.5, 100, "horizontal velocity derivative filter, Hz"),
            Parameter("PSC_VELZ_P", 5, 1, 8, "vertical velocity gain, 1/s"),
            Parameter("PSC_VELZ_FLTE", 5, 0.5, 100, "vertical velocity error filter, Hz"),
            Parameter("RC_OVERRIDE_TIME", 3, -1, 120, "timeout of RC overrides, s; -1 never"),
            Parameter("RTL_ALT", 1500, 30, 300000, "height of the return above home, cm", _INT32),
            Parameter("RTL_ALT_FINAL", 0, 0, 1000, "height at which the return ends, cm; 0 lands", _INT16),
            Parameter("RTL_CLIMB_MIN", 0, 0, 3000, "minimum climb before returning, cm", _INT16),
            Parameter("RTL_CONE_SLOPE", 3, 0, 10, "height over distance of the cone that limits the climb; 0 none"),
            Parameter("RTL_LOIT_TIME", 5000, 0, 60000, "wait above home, ms", _INT32),
            Parameter("RTL_SPEED", 0, 0, 2000, "speed of the return, cm/s; 0 WPNAV_SPEED", _INT16),
            Parameter("SYSID_ENFORCE", 0, 0, 1, "1: obey only SYSID_MYGCS and its own components", _INT8),
            Parameter("SYSID_MYGCS", 255, 1, 255, "system id of the ground station", _INT16),
            Parameter("SYSID_THISMAV", 1, 1, 255, "MAVLink system id", _INT16, reboot=True),
            Parameter("THR_DZ", 100, 0, 300, "dead zone of the throttle stick, 1/1000 each way", _INT16),
            Parameter("TKOFF_SLEW_TIME", 2, 0.25, 5, "throttle from zero to full at take-off, s"),
            Parameter(
                "WP_YAW_BEHAVIOR",
                2,
                0,
                3,
                "0 never turn, 1 face the next waypoint, 2 except in RTL, 3 face the course",
                _INT8,
            ),
            Parameter("WPNAV_ACCEL", 250, 50, 500, "horizontal acceleration, cm/s²"),
            Parameter("WPNAV_ACCEL_C", 0, 0, 500, "acceleration in corners, cm/s²; 0 twice WPNAV_ACCEL"),
            Parameter("WPNAV_ACCEL_Z", 100, 50, 500, "vertical acceleration, cm/s²"),
            Parameter("WPNAV_JERK", 1, 1, 20, "jerk along legs, m/s³"),
            Parameter("WPNAV_RADIUS", 200, 5, 1000, "acceptance radius of waypoints, cm"),
            Parameter("WPNAV_SPEED", 1000, 10, 2000, "horizontal speed, cm/s"),
            Parameter("WPNAV_SPEED_DN", 150, 10, 500, "descent speed, cm/s"),
            Parameter("WPNAV_SPEED_UP", 250, 10, 1000, "climb speed, cm/s"),
            *stream_rates("SR0_"),
        )
    )
)
"""Every parameter, by name. The position in this table is the index of the protocol."""

INDEX: Final = {parameter.name: index for index, parameter in enumerate(PARAMETERS)}
MIN_VALUES: Final = np.array([parameter.low for parameter in PARAMETERS], dtype=np.float64)
MAX_VALUES: Final = np.array([parameter.high for parameter in PARAMETERS], dtype=np.float64)

_LOOP_PREFIXES = ("ANGLE_MAX", "ATC_", "LAND_", "LOIT_", "MOT_", "PILOT_", "PSC_", "TKOFF_", "WP")
"""Parameters read in every step come first in the record and side by side, so that the rest costs no cache lines."""
_MESSAGE_PREFIXES = ("SR0_", "SYSID_")
"""Parameters that only messages read are not in the record."""


def _settings_names() -> tuple[str, ...]:
    names = [parameter.name for parameter in PARAMETERS if not parameter.name.startswith(_MESSAGE_PREFIXES)]
    return tuple(sorted(names, key=lambda name: (not name.startswith(_LOOP_PREFIXES), name)))


SETTINGS_NAMES: Final = _settings_names()
SETTINGS: Final = np.dtype([(name, "f8") for name in SETTINGS_NAMES])
"""The parameters of one aircraft as a record, limited to their ranges."""

AIRFRAME_TUNING: Final[Mapping[str, Mapping[str, float]]] = {
    # The Iris has a quarter of the yaw authority that ArduCopter's defaults are meant for (4 rad/s² at full
    # yaw): the rate loop has higher gains and lower targets, as in a tuned aircraft's parameter file.
    "iris": {"ATC_RAT_YAW_P": 1.5, "ATC_RAT_YAW_I": 0.15, "ATC_RAT_YAW_FLTE": 20, "ATC_ACCEL_Y_MAX": 6000},
    # Full yaw gives these two 16 and 6.8 rad/s²: the rate loop has a bandwidth of about 6 rad/s, like the Iris's.
    "hummingbird": {"ATC_RAT_YAW_P": 0.4, "ATC_RAT_YAW_I": 0.04, "ATC_RAT_YAW_FLTE": 20},
    "x500": {"ATC_RAT_YAW_P": 0.9, "ATC_RAT_YAW_I": 0.09, "ATC_RAT_YAW_FLTE": 20, "ATC_ACCEL_Y_MAX": 10000},
}
"""Values that differ from the defaults, by airframe."""


_LIMITS: Final = {_INT8: (-128.0, 127.0), _INT16: (-32768.0, 32767.0), _INT32: (-2147483648.0, 2147483647.0)}


def stored_value(parameter: Parameter, value: float) -> float:
    """Return a finite value as ArduPilot stores it (AP_Param::set_float): single precision, or a truncated integer."""
    limits = _LIMITS.get(parameter.kind)
    if limits is None:
        return float(np.float32(min(max(value, -_MAX_FLOAT32), _MAX_FLOAT32)))
    nudged = value + (0.01 if value >= 0.0 else -0.01)
    return float(math.trunc(min(max(nudged, limits[0]), limits[1])))


_MAX_FLOAT32 = float(np.finfo(np.float32).max)


def hover_throttle(airframe: Airframe) -> float:
    """Return MOT_THST_HOVER: the thrust whose command carries the weight, at the battery's rated voltage.

    It is less than the share of full thrust, because zero thrust is MOT_SPIN_MIN and full thrust MOT_SPIN_MAX
    (`Thrust_Linearization::actuator_to_thrust`, with the defaults).
    """
    low, high = (PARAMETERS[INDEX[name]].default for name in ("MOT_SPIN_MIN", "MOT_SPIN_MAX"))
    part = (airframe.hover_command - low) / (high - low)
    return (1.0 - airframe.thrust_expo) * part + airframe.thrust_expo * part * part


def value_in_range(parameter: Parameter, value: float) -> float:
    """Return the value that takes effect: `value` limited to the range."""
    return min(max(value, parameter.low), parameter.high)


def initial_values(who: str, airframe: Airframe, system_id: int, given: Mapping[str, float]) -> NDArray[np.float64]:
    """Return (parameters,) initial values: defaults, the airframe's tuning, then `given`, with names of any version.

    Raises `InputError` with every unknown name and every value that is not finite or out of range.
    """
    values: dict[str, float] = {"SYSID_THISMAV": system_id}
    problems = []
    taken: dict[str, str] = {}
    for name, value in given.items():
        known = canonical_name(name)
        parameter = PARAMETERS[INDEX[known]] if known in INDEX else None
        shown = f"{name} ({known})" if known != name else name
        if parameter is None:
            problems.append(Problem(name, str(value), "a parameter of the builtin autopilot", nearest(name, INDEX)))
        elif known in taken:
            problems.append(Problem(shown, str(value), f"given once; {taken[known]} is the same parameter"))
        elif not (math.isfinite(value) and parameter.low <= to_canonical(name, value) <= parameter.high):
            low, high = from_canonical(name, parameter.low), from_canonical(name, parameter.high)
            problems.append(Problem(shown, str(value), f"{low:g} to {high:g} ({parameter.meaning})"))
        elif known == "SYSID_THISMAV":
            problems.append(Problem(shown, str(value), "the vehicle's system_id, which sets it"))
        else:
            values[known] = to_canonical(name, value)
        taken.setdefault(known, name)
    if problems:
        raise InputError(f"params of {who}", problems)
    stored = np.array(_stored_defaults(airframe))
    for name, value in values.items():
        stored[INDEX[name]] = stored_value(PARAMETERS[INDEX[name]], value)
    return stored


@cache
def _stored_defaults(airframe: Airframe) -> tuple[float, ...]:
    """The values of an airframe that is given none, in the order of `PARAMETERS`."""
    values = {parameter.name: parameter.default for parameter in PARAMETERS}
    values.update(AIRFRAME_TUNING.get(airframe.name, {}))
    values["MOT_THST_HOVER"] = hover_throttle(airframe)
    values["MOT_THST_EXPO"] = airframe.thrust_expo
    return tuple(stored_value(parameter, values[parameter.name]) for parameter in PARAMETERS)


def fill_settings(
    settings: Records, row: int, who: str, airframe: Airframe, system_id: int, given: Mapping[str, float]
) -> NDArray[np.float64]:
    """Write the result of `initial_values` to a settings record and return it; raises as that does."""
    values = initial_values(who, airframe, system_id, given)
    apply_stored(settings, row, values)
    return values


def apply_stored(settings: Records, row: int, values: NDArray[np.float64]) -> None:
    """Write stored values to a settings record."""
    acting = np.clip(values, MIN_VALUES, MAX_VALUES)
    for name in SETTINGS_NAMES:
        settings[name][row] = acting[INDEX[name]]
