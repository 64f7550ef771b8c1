"""Parameter names of ArduCopter 4.7, the 4.6 names that they replace, and the factors between their units.

ArduCopter 4.7 renamed what was in centimetres, centidegrees and the like to metres and degrees, and moved the MAVLink
parameters together (https://ardupilot.org/copter/docs/common-param-name-changes.html, "ArduPilot 4.6 → 4.7"; 4.7.1
moved the two jerks once more). Wherever a parameter is named, both names mean the same parameter.
"""

from __future__ import annotations

from typing import Final

_CENTI: Final = 100.0
_INVERSE: Final = 0.0
"""In place of a factor: the mask of checks to skip, where 4.6 has the mask of checks to run."""
_CHECKS: Final = ((1 << 21) - 1) & ~1
"""ARMING_CHECK's bits except the first, which stands for all of them."""


def _renamed() -> dict[str, tuple[str, float]]:
    """Return the table of 4.7 names: (4.6 name, factor from a 4.7 value to a 4.6 value)."""
    table: dict[str, tuple[str, float]] = {
        "MAV_SYSID": ("SYSID_THISMAV", 1.0),
        "MAV_GCS_SYSID": ("SYSID_MYGCS", 1.0),
        "MAV_OPTIONS": ("SYSID_ENFORCE", 1.0),  # its bit 0
        "MAV_TELEM_DELAY": ("TELEM_DELAY", 1.0),
        "ARMING_SKIPCHK": ("ARMING_CHECK", _INVERSE),
        "ATC_ANGLE_MAX": ("ANGLE_MAX", _CENTI),
        "ATC_RATE_WPY_MAX": ("ATC_SLEW_YAW", _CENTI),
        "CIRCLE_RADIUS_M": ("CIRCLE_RADIUS", _CENTI),
        "LAND_ALT_LOW_M": ("LAND_ALT_LOW", _CENTI),
        "LAND_SPD_HIGH_MS": ("LAND_SPEED_HIGH", _CENTI),
        "LAND_SPD_MS": ("LAND_SPEED", _CENTI),
        "LOIT_ACC_MAX_M": ("LOIT_ACC_MAX", _CENTI),
        "LOIT_BRK_ACC_M": ("LOIT_BRK_ACCEL", _CENTI),
        "LOIT_BRK_JRK_M": ("LOIT_BRK_JERK", _CENTI),
        "LOIT_SPEED_MS": ("LOIT_SPEED", _CENTI),
        "PHLD_BRK_ANGLE": ("PHLD_BRAKE_ANGLE", _CENTI),
        "PHLD_BRK_RATE": ("PHLD_BRAKE_RATE", 1.0),
        "PILOT_ACC_Z": ("PILOT_ACCEL_Z", _CENTI),
        "PILOT_SPD_DN": ("PILOT_SPEED_DN", _CENTI),
        "PILOT_SPD_UP": ("PILOT_SPEED_UP", _CENTI),
        "PILOT_TKO_ALT_M": ("PILOT_TKOFF_ALT", _CENTI),
        "PSC_D_POS_P": ("PSC_POSZ_P", 1.0),
        "PSC_NE_POS_P": ("PSC_POSXY_P", 1.0),
        "PSC_JERK_NE": ("PSC_JERK_XY", 1.0),
        "PSC_JERK_D": ("PSC_JERK_Z", 1.0),
        "PSC_NE_JERK": ("PSC_JERK_XY", 1.0),
        "PSC_D_JERK": ("PSC_JERK_Z", 1.0),
        "RTL_ALT_FINAL_M": ("RTL_ALT_FINAL", _CENTI),
        "RTL_ALT_M": ("RTL_ALT", _CENTI),
        "RTL_CLIMB_MIN_M": ("RTL_CLIMB_MIN", _CENTI),
        "RTL_SPEED_MS": ("RTL_SPEED", _CENTI),
        "WP_ACC": ("WPNAV_ACCEL", _CENTI),
        "WP_ACC_CNR": ("WPNAV_ACCEL_C", _CENTI),
        "WP_ACC_Z": ("WPNAV_ACCEL_Z", _CENTI),
        "WP_JERK": ("WPNAV_JERK", 1.0),
        "WP_RADIUS_M": ("WPNAV_RADIUS", _CENTI),
        "WP_RFND_USE": ("WPNAV_RFND_USE", 1.0),
        "WP_SPD": ("WPNAV_SPEED", _CENTI),
        "WP_SPD_DN": ("WPNAV_SPEED_DN", _CENTI),
        "WP_SPD_UP": ("WPNAV_SPEED_UP", _CENTI),
        "WP_TER_MARGIN": ("WPNAV_TER_MARGIN", 1.0),
    }
    for axis in "RPY":
        table[f"ATC_ACC_{axis}_MAX"] = (f"ATC_ACCEL_{axis}_MAX", _CENTI)
    for part in ("P", "I", "D", "FF", "FLTE", "FLTD", "IMAX"):
        factor = _CENTI if part == "IMAX" else 1.0
        table[f"PSC_NE_VEL_{part}"] = (f"PSC_VELXY_{part}", factor)
        table[f"PSC_D_VEL_{part}"] = (f"PSC_VELZ_{part}", factor)
    # thrust 1 per m/s² instead of 1/1000 per cm/s²: a factor of ten; the limit was in 1/1000
    for part, factor in (("P", 10.0), ("I", 10.0), ("D", 10.0), ("FF", 10.0), ("IMAX", 1000.0), ("FLTE", 1.0)):
        table[f"PSC_D_ACC_{part}"] = (f"PSC_ACCZ_{part}", factor)
    for channel in range(4):
        for name in STREAM_PARAMETERS:
            table[f"MAV{channel + 1}_{name}"] = (f"SR{channel}_{name}", 1.0)
    return table


STREAM_PARAMETERS: Final = (
    "RAW_SENS", "EXT_STAT", "RC_CHAN", "RAW_CTRL", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3", "PARAMS", "ADSB",
)  # fmt: skip
"""Rates of streams, in Hz: `MAV1_…` or `SR0_…` for the first channel."""
RENAMED: Final = _renamed()
"""4.7 name → (4.6 name, factor from a 4.7 value to a 4.6 value, or `_INVERSE`)."""


def canonical_name(name: str) -> str:
    """Return the 4.6 name of a parameter; 4.6 names and unknown ones are kept. Case is ignored (AP_Param::find)."""
    upper = name.upper()
    return RENAMED[upper][0] if upper in RENAMED else upper


def to_canonical(name: str, value: float) -> float:
    """Convert a finite value of `name` to the 4.6 unit."""
    factor = RENAMED.get(name.upper(), ("", 1.0))[1]
    return value * factor if factor != _INVERSE else _inverted(value)


def from_canonical(name: str, value: float) -> float:
    """Convert a value in the 4.6 unit to the unit of `name`."""
    factor = RENAMED.get(name.upper(), ("", 1.0))[1]
    if factor == _INVERSE:
        return -1.0 if value == 0.0 else 0.0 if int(value) & 1 else float(~int(value) & _CHECKS)
    return value / factor


def _inverted(skipped: float) -> float:
    """Return ARMING_CHECK of an ARMING_SKIPCHK: all checks (1) where nothing is skipped, none where all are (-1)."""
    if skipped == 0.0:
        return 1.0
    return 0.0 if skipped < 0.0 or skipped >= 2**31 else float(~int(skipped) & _CHECKS)
