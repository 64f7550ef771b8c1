"""Parameter names of ArduCopter 4.7, the 4.6 names that they replace, and the factors between their units.

ArduCopter 4.7 renamed what was in centimetres, centidegrees and the like to metres and degrees, and moved the MAVLink
parameters together (https://ardupilot.org/copter/docs/common-param-name-changes.html, "ArduPilot 4.6 → 4.7"; 4.7.1
moved the two jerks once more). Wherever a parameter is named, both names mean the same parameter. `renames.csv` has the
table. Vertical acceleration gains have a factor of ten (thrust of 1 per m/s², and of 1/1000 per cm/s²); MAV_OPTIONS is
SYSID_ENFORCE in its bit 0.
"""

from __future__ import annotations

from typing import Final

from skyrange.core.files import read_package_table

_INVERSE: Final = 0.0
"""In place of a factor: the mask of checks to skip, where 4.6 has the mask of checks to run."""
_CHECKS: Final = ((1 << 21) - 1) & ~1
"""ARMING_CHECK's bits except the first, which stands for all of them."""


STREAM_PARAMETERS: Final = (
    "RAW_SENS", "EXT_STAT", "RC_CHAN", "RAW_CTRL", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3", "PARAMS", "ADSB",
)  # fmt: skip
"""Rates of streams, in Hz: `MAV1_…` or `SR0_…` for the first channel."""
RENAMED: Final[dict[str, tuple[str, float]]] = {
    row["name_4_7"]: (row["name_4_6"], _INVERSE if row["factor"] == "inverse" else float(row["factor"]))
    for row in read_package_table(__file__, "renames.csv")
}
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
