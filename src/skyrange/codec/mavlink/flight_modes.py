"""Flight modes by vehicle: the meaning of a HEARTBEAT's `custom_mode`, which depends on its `type` and `autopilot`.

ArduPilot's firmwares number their modes differently (4 is GUIDED on ArduCopter, and ACRO on ArduPlane). The names are
those of the dialect's enums COPTER_MODE, PLANE_MODE …; which enum belongs to which MAV_TYPE is pymavlink's
`mavutil.AP_MAV_TYPE_MODE_MAP`. Other autopilots have numbers of their own, which the dialect does not name.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from skyrange.codec.mavlink.frames import dialect

FlightModes = Mapping[int, str]
"""Names of modes by their number in `custom_mode`."""


def _read_enum(name: str) -> FlightModes:
    """The modes of an enum such as COPTER_MODE, without its prefix and its end mark."""
    entries = {number: str(entry.name).removeprefix(f"{name}_") for number, entry in dialect.enums[name].items()}
    return MappingProxyType({number: entry for number, entry in entries.items() if entry != "ENUM_END"})


COPTER_MODES: Final = _read_enum("COPTER_MODE")
COPTER_MODE_NUMBERS: Final = MappingProxyType({name: number for number, name in COPTER_MODES.items()})
"""Numbers of ArduCopter's modes by name."""
_PLANE: Final = _read_enum("PLANE_MODE")
_ROVER: Final = _read_enum("ROVER_MODE")
MULTIROTOR_TYPES: Final = (
    int(dialect.MAV_TYPE_TRICOPTER),
    int(dialect.MAV_TYPE_QUADROTOR),
    int(dialect.MAV_TYPE_HEXAROTOR),
    int(dialect.MAV_TYPE_OCTOROTOR),
    int(dialect.MAV_TYPE_DECAROTOR),
    int(dialect.MAV_TYPE_DODECAROTOR),
)
"""What an ArduCopter with a multirotor frame reports (AP_MotorsMatrix.cpp, `_mav_type`)."""
_TABLES: Final[Mapping[int, FlightModes]] = {
    **dict.fromkeys((*MULTIROTOR_TYPES, dialect.MAV_TYPE_HELICOPTER, dialect.MAV_TYPE_COAXIAL), COPTER_MODES),
    dialect.MAV_TYPE_FIXED_WING: _PLANE,
    dialect.MAV_TYPE_VTOL_TILTROTOR: _PLANE,
    dialect.MAV_TYPE_VTOL_DUOROTOR: _PLANE,
    dialect.MAV_TYPE_VTOL_QUADROTOR: _PLANE,
    dialect.MAV_TYPE_GROUND_ROVER: _ROVER,
    dialect.MAV_TYPE_SURFACE_BOAT: _ROVER,
    dialect.MAV_TYPE_ANTENNA_TRACKER: _read_enum("TRACKER_MODE"),
    dialect.MAV_TYPE_SUBMARINE: _read_enum("SUB_MODE"),
}
"""Of ArduPilot's vehicles, by MAV_TYPE."""


def find_flight_modes(vehicle_type: int, autopilot: int) -> FlightModes | None:
    """The modes of a vehicle by its MAV_TYPE and MAV_AUTOPILOT; `None` where the dialect does not name them."""
    return _TABLES.get(vehicle_type) if autopilot == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA else None


def mode_name(vehicle_type: int, autopilot: int, mode: int) -> str:
    """The name of a HEARTBEAT's `custom_mode`, or the number itself where that vehicle has no name for it."""
    modes = find_flight_modes(vehicle_type, autopilot) or {}
    return modes.get(mode, str(mode))


def is_arducopter_multirotor(vehicle_type: int, autopilot: int) -> bool:
    """Whether a HEARTBEAT is that of an ArduCopter with a multirotor frame, the only vehicle that skyrange flies."""
    return autopilot == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA and vehicle_type in MULTIROTOR_TYPES


def vehicle_name(vehicle_type: int, autopilot: int) -> str:
    """A vehicle in MAVLink's words, such as `MAV_TYPE_QUADROTOR with MAV_AUTOPILOT_PX4`."""
    return f"{_entry_name('MAV_TYPE', vehicle_type)} with {_entry_name('MAV_AUTOPILOT', autopilot)}"


def _entry_name(enum: str, value: int) -> str:
    entry = dialect.enums[enum].get(value)
    known = entry is not None and not entry.name.endswith("_ENUM_END")
    return str(entry.name) if known else f"{enum} {value}"
