"""Which parameters are there, and how are they asked for and set? ArduCopter's names, units and defaults.

Only parameters that act are listed. Names and units are those of ArduCopter 4.6 (centimetres where it
has centimetres); defaults are from its sources: libraries/AC_AttitudeControl (AC_PosControl.cpp,
AC_AttitudeControl_Multi.h), libraries/AC_WPNav/AC_WPNav.cpp, libraries/AP_Motors, ArduCopter/config.h.
Values are single floats, as there. The protocol is https://mavlink.io/en/services/parameter.html in
ArduPilot's dialect of it: a value travels as a float whatever its type, an unknown name or a value
that is not finite is not answered (libraries/GCS_MAVLink/GCS_Param.cpp), a value out of range is
held inside it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.core.errors import Fault, InputError, nearest
from skyrange.vehicle.builtin.layout import Records
from skyrange.world.airframes import Airframe

_REAL32 = dialect.MAV_PARAM_TYPE_REAL32
_INT8 = dialect.MAV_PARAM_TYPE_INT8
_INT16 = dialect.MAV_PARAM_TYPE_INT16
_INT32 = dialect.MAV_PARAM_TYPE_INT32


class Parameter(NamedTuple):
    """One parameter: default and range in ArduCopter's unit, `kind` a MAV_PARAM_TYPE."""

    name: str
    default: float
    low: float
    high: float
    meaning: str
    kind: int = _REAL32


PARAMETERS: Final = tuple(
    sorted(
        (
            Parameter("ANGLE_MAX", 3000, 1000, 8000, "largest lean angle, cdeg", _INT16),
            Parameter("ATC_ACCEL_R_MAX", 110000, 1000, 180000, "roll acceleration limit, cdeg/s²"),
            Parameter("ATC_ACCEL_P_MAX", 110000, 1000, 180000, "pitch acceleration limit, cdeg/s²"),
            Parameter("ATC_ACCEL_Y_MAX", 27000, 1000, 72000, "yaw acceleration limit, cdeg/s²"),
            Parameter("ATC_INPUT_TC", 0.15, 0, 1, "how softly attitudes are taken: time constant, s"),
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
            Parameter("ATC_SLEW_YAW", 6000, 500, 18000, "largest yaw rate asked for, cdeg/s"),
            Parameter("AUTO_OPTIONS", 0, 0, 255, "bit 0: arm in AUTO; bit 1: take off in AUTO unasked", _INT32),
            Parameter("CIRCLE_OPTIONS", 1, 0, 15, "bit 1: face along the circle instead of its centre", _INT16),
            Parameter("CIRCLE_RADIUS", 1000, 0, 200000, "radius of circles that name none, cm"),
            Parameter("CIRCLE_RATE", 20, -90, 90, "turn rate of circles, deg/s"),
            Parameter("DISARM_DELAY", 10, 0, 127, "disarm after so long armed on the ground, s; 0 never", _INT8),
            Parameter("GUID_OPTIONS", 0, 0, 255, "bit 6: positions in GUIDED are flown as waypoints", _INT32),
            Parameter("GUID_TIMEOUT", 3, 0.1, 5, "a velocity target in GUIDED holds so long, s"),
            Parameter("LAND_ALT_LOW", 1000, 100, 10000, "height of the final descent, cm", _INT16),
            Parameter("LAND_SPEED", 50, 30, 200, "speed of the final descent, cm/s", _INT16),
            Parameter("LAND_SPEED_HIGH", 0, 0, 500, "speed above LAND_ALT_LOW, cm/s; 0 WPNAV_SPEED_DN", _INT16),
            Parameter("LOIT_ACC_MAX", 500, 100, 981, "position correction of LOITER, cm/s²"),
            Parameter("LOIT_ANG_MAX", 0, 0, 45, "largest lean in LOITER, deg; 0 two thirds of ANGLE_MAX"),
            Parameter("LOIT_BRK_ACCEL", 250, 25, 250, "braking of LOITER, cm/s²"),
            Parameter("LOIT_BRK_DELAY", 1, 0, 2, "LOITER brakes so long after the sticks are let go, s"),
            Parameter("LOIT_BRK_JERK", 500, 500, 5000, "its jerk, cm/s³"),
            Parameter("LOIT_SPEED", 1250, 20, 3500, "greatest speed in LOITER, cm/s"),
            Parameter("MIS_RESTART", 0, 0, 1, "AUTO resumes the mission (0) or restarts it (1)", _INT8),
            Parameter("MOT_SPIN_ARM", 0.10, 0, 1, "command when armed on the ground"),
            Parameter("MOT_SPIN_MIN", 0.15, 0, 1, "least command in flight"),
            Parameter("MOT_SPOOL_TIME", 0.5, 0.05, 2, "from ground idle to full range, s"),
            Parameter("MOT_THST_EXPO", 0.65, -1, 1, "curve from command to thrust that is inverted"),
            Parameter("MOT_THST_HOVER", 0.35, 0.125, 0.6875, "thrust that hovers, of 1"),
            Parameter("PILOT_ACCEL_Z", 250, 50, 500, "vertical acceleration in a pilot's modes, cm/s²", _INT16),
            Parameter("PILOT_SPEED_DN", 0, 0, 500, "descent speed in a pilot's modes, cm/s; 0 PILOT_SPEED_UP", _INT16),
            Parameter("PILOT_SPEED_UP", 250, 50, 500, "climb speed in a pilot's modes, cm/s", _INT16),
            Parameter("PILOT_Y_EXPO", 0, -0.5, 0.95, "softness of the yaw stick's middle"),
            Parameter("PILOT_Y_RATE", 202.5, 1, 360, "yaw rate of the full stick, deg/s"),
            Parameter("PSC_ACCZ_P", 0.5, 0.2, 1.5, "vertical acceleration gain, 1/1000 per cm/s²"),
            Parameter("PSC_ACCZ_I", 1.0, 0, 3, "vertical acceleration integral gain"),
            Parameter("PSC_ACCZ_IMAX", 800, 0, 1000, "its limit, 1/1000"),
            Parameter("PSC_ACCZ_FLTE", 20, 1, 100, "its error filter, Hz"),
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
            Parameter("RC_OVERRIDE_TIME", 3, -1, 120, "sticks sent by MAVLink hold so long, s; 0 none count, -1 for ever"),
            Parameter("RTL_ALT", 1500, 30, 300000, "height of the return above home, cm", _INT32),
            Parameter("RTL_ALT_FINAL", 0, 0, 1000, "height at which the return ends, cm; 0 lands", _INT16),
            Parameter("RTL_CLIMB_MIN", 0, 0, 3000, "climb at least so much before returning, cm", _INT16),
            Parameter("RTL_CONE_SLOPE", 3, 0, 10, "height over distance of the cone that lowers the climb; 0 none"),
            Parameter("RTL_LOIT_TIME", 5000, 0, 60000, "wait above home, ms", _INT32),
            Parameter("RTL_SPEED", 0, 0, 2000, "speed of the return, cm/s; 0 WPNAV_SPEED", _INT16),
            Parameter("SR0_EXT_STAT", 0, 0, 50, "boot rate of status messages, Hz", _INT16),
            Parameter("SR0_EXTRA1", 0, 0, 50, "boot rate of ATTITUDE, Hz", _INT16),
            Parameter("SR0_EXTRA2", 0, 0, 50, "boot rate of VFR_HUD, Hz", _INT16),
            Parameter("SR0_EXTRA3", 0, 0, 50, "boot rate of SYSTEM_TIME and the like, Hz", _INT16),
            Parameter("SR0_POSITION", 0, 0, 50, "boot rate of position messages, Hz", _INT16),
            Parameter("SYSID_MYGCS", 255, 1, 255, "the ground station whose sticks count", _INT16),
            Parameter("SYSID_THISMAV", 1, 1, 255, "MAVLink system id", _INT16),
            Parameter("THR_DZ", 100, 0, 300, "dead zone of the throttle stick, 1/1000 each way", _INT16),
            Parameter("TKOFF_SLEW_TIME", 2, 0.25, 5, "throttle from zero to full at take-off, s"),
            Parameter("WP_YAW_BEHAVIOR", 2, 0, 3, "0 never turn, 1 face the next waypoint, 2 except in RTL, 3 face ahead", _INT8),
            Parameter("WPNAV_ACCEL", 250, 50, 500, "horizontal acceleration, cm/s²"),
            Parameter("WPNAV_ACCEL_C", 0, 0, 500, "acceleration in corners, cm/s²; 0 twice WPNAV_ACCEL"),
            Parameter("WPNAV_ACCEL_Z", 100, 50, 500, "vertical acceleration, cm/s²"),
            Parameter("WPNAV_JERK", 1, 1, 20, "jerk along legs, m/s³"),
            Parameter("WPNAV_RADIUS", 200, 5, 1000, "acceptance radius of waypoints, cm"),
            Parameter("WPNAV_SPEED", 1000, 10, 2000, "horizontal speed, cm/s"),
            Parameter("WPNAV_SPEED_DN", 150, 10, 500, "descent speed, cm/s"),
            Parameter("WPNAV_SPEED_UP", 250, 10, 1000, "climb speed, cm/s"),
        )
    )
)
"""Every parameter, by name: the index in this table is the protocol's index."""

INDEX: Final = {parameter.name: index for index, parameter in enumerate(PARAMETERS)}
SETTINGS: Final = np.dtype([(parameter.name, "f8") for parameter in PARAMETERS])
"""One aircraft's parameters as a record, for the kernels."""

TUNING: Final[Mapping[str, Mapping[str, float]]] = {
    # The Iris has a quarter of the yaw authority that ArduCopter's defaults are meant for (4 rad/s² at full
    # yaw): the rate loop is closed tighter and asked for less, as a tuned aircraft's parameter file would.
    "iris": {"ATC_RAT_YAW_P": 1.5, "ATC_RAT_YAW_I": 0.15, "ATC_RAT_YAW_FLTE": 20, "ATC_ACCEL_Y_MAX": 6000},
}
"""What differs from the defaults by airframe."""


def held(parameter: Parameter, value: float) -> float:
    """A finite value as the autopilot stores it: inside the range, whole where the type is, a single float."""
    inside = min(max(value, parameter.low), parameter.high)
    return float(np.float32(inside if parameter.kind == _REAL32 else math.floor(inside + 0.5)))


def fill(settings: Records, row: int, who: str, airframe: Airframe, system_id: int, given: Mapping[str, float]) -> None:
    """Set a row to defaults, the airframe's tuning, then `given` (ArduCopter's units).

    Raises `InputError` with every unknown name and every value that is not finite or out of range.
    """
    values = {parameter.name: parameter.default for parameter in PARAMETERS}
    values.update(TUNING.get(airframe.name, {}))
    values["MOT_THST_HOVER"] = airframe.hover_thrust
    values["MOT_THST_EXPO"] = airframe.thrust_expo
    values["SYSID_THISMAV"] = system_id
    faults = []
    for name, value in given.items():
        parameter = PARAMETERS[INDEX[name]] if name in INDEX else None
        if parameter is None:
            faults.append(Fault(name, str(value), "a parameter of the builtin autopilot", nearest(name, INDEX)))
        elif not (math.isfinite(value) and parameter.low <= value <= parameter.high):
            faults.append(Fault(name, str(value), f"{parameter.low:g} to {parameter.high:g} ({parameter.meaning})"))
        elif name == "SYSID_THISMAV":
            faults.append(Fault(name, str(value), "the vehicle's system_id, which sets it"))
        else:
            values[name] = value
    if faults:
        raise InputError(f"params of {who}", faults)
    for parameter in PARAMETERS:
        settings[parameter.name][row] = held(parameter, values[parameter.name])


def clean_name(raw: object) -> str:
    """A PARAM_* message's name field as text; bytes that are no ASCII cannot name a parameter."""
    if isinstance(raw, bytes):
        raw = raw.decode("ascii", "replace")
    return str(raw).split("\0", 1)[0]


def value_message(settings: Records, row: int, index: int, told_index: int) -> object:
    """PARAM_VALUE of the parameter at `index`; `told_index` is what the message calls it (65535 after a set)."""
    parameter = PARAMETERS[index]
    return dialect.MAVLink_param_value_message(
        parameter.name.encode(), float(settings[parameter.name][row]), parameter.kind, len(PARAMETERS), told_index
    )
