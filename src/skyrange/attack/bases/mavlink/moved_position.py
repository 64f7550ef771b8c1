"""Position that telemetry tells: moved by an offset or to a track, in all messages that tell one.

Barometric pressure (SCALED_PRESSURE), the distance to the next waypoint (NAV_CONTROLLER_OUTPUT) and the rangefinder
stay true: a receiver that compares them can find the lie.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees
from typing import Any, Final

from skyrange.attack.bases.mavlink.message_fields import move_place, put
from skyrange.attack.contract import Place
from skyrange.core.elementary import atan2, hypot
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time

STILL: Final = (0.0, 0.0, 0.0)
"""No offset, or no velocity."""
_PLACED: Final[Mapping[str, tuple[str, str]]] = {
    "GLOBAL_POSITION_INT": ("lat", "lon"),
    "GPS_RAW_INT": ("lat", "lon"),
    "GPS2_RAW": ("lat", "lon"),
    "AHRS2": ("lat", "lng"),
    "TERRAIN_REPORT": ("lat", "lon"),
    "OPEN_DRONE_ID_LOCATION": ("latitude", "longitude"),
}
"""Fields with latitude and longitude in 1e-7 degrees; both 0 without a position."""
_HEIGHTS: Final[Mapping[str, tuple[tuple[str, float], ...]]] = {
    "GLOBAL_POSITION_INT": (("alt", 1e3), ("relative_alt", 1e3)),
    "GPS_RAW_INT": (("alt", 1e3), ("alt_ellipsoid", 1e3)),
    "GPS2_RAW": (("alt", 1e3), ("alt_ellipsoid", 1e3)),
    "AHRS2": (("altitude", 1.0),),
    "TERRAIN_REPORT": (("current_height", 1.0),),
    "OPEN_DRONE_ID_LOCATION": (("altitude_barometric", 1.0), ("altitude_geodetic", 1.0), ("height", 1.0)),
    "LOCAL_POSITION_NED": (("z", -1.0),),
    "VFR_HUD": (("alt", 1.0),),
}
"""Fields with heights, and their units per metre."""
POSITION_MESSAGES: Final = tuple(_HEIGHTS)
"""All messages that tell a position, by name."""
_NO_HEIGHT_M: Final = -1000.0
"""OPEN_DRONE_ID_LOCATION: an unknown height."""


@dataclass(slots=True)
class MovedPosition:
    """Moves reported positions and velocities; heights above home move as heights above sea level do."""

    origin: Origin
    offset_m: Place
    rate_mps: Place
    at: Place | None
    """Where a track begins; `None`: an offset."""
    place: Place | None = None
    """The last true position reported, metres from the origin."""
    velocity: Place = STILL
    """The last true velocity reported, m/s east, north and up."""

    def learn(self, message: str, fields: Any) -> None:
        """Learn the true position and velocity, if the message tells both."""
        if message == "GLOBAL_POSITION_INT":
            east_m, north_m = self.origin.enu_of(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
            self.place = (east_m, north_m, fields["alt"] * 1e-3 - self.origin.alt_msl_m)
            self.velocity = (fields["vy"] * 1e-2, fields["vx"] * 1e-2, -fields["vz"] * 1e-2)

    def alter(self, message: str, fields: Any, since_ns: Time) -> bool:
        """Move what the message tells, if the true position is known where it has to be; see `AlteredTelemetry`."""
        self.learn(message, fields)
        if self.at is not None and self.place is None:
            return False
        seconds = since_ns / NS_PER_S
        first, rate = self.at or self.offset_m, self.rate_mps
        shift = (first[0] + rate[0] * seconds, first[1] + rate[1] * seconds, first[2] + rate[2] * seconds)
        if self.at is not None and self.place is not None:
            shift = (shift[0] - self.place[0], shift[1] - self.place[1], shift[2] - self.place[2])
            _set_velocity(message, fields, rate, from_track=True)
        elif rate != STILL and self.place is not None:
            true = self.velocity
            _set_velocity(message, fields, (true[0] + rate[0], true[1] + rate[1], true[2] + rate[2]), from_track=False)
        self._move(message, fields, shift)
        return True

    def _move(self, message: str, fields: Any, by_m: Place) -> None:
        if message == "LOCAL_POSITION_NED":
            put(fields, "x", fields["x"] + by_m[1])
            put(fields, "y", fields["y"] + by_m[0])
        elif message in _PLACED:
            lat, lon = _PLACED[message]
            if not (fields[lat] or fields[lon]):
                return
            move_place(fields, lat, lon, by_m, self.origin)
        for name, units in _HEIGHTS[message]:
            unknown = name == "alt_ellipsoid" and fields[name] == 0
            if not unknown and not (message == "OPEN_DRONE_ID_LOCATION" and fields[name] == _NO_HEIGHT_M):
                put(fields, name, fields[name] + by_m[2] * units)


def _set_velocity(message: str, fields: Any, velocity: Place, *, from_track: bool) -> None:
    """Write a velocity (m/s east, north and up) into a message; the course too, and the heading of a false track."""
    east, north, up = velocity
    speed = hypot(east, north)
    course_deg = degrees(atan2(east, north)) % 360.0
    if message == "GLOBAL_POSITION_INT":
        for name, value in (("vx", north), ("vy", east), ("vz", -up)):
            put(fields, name, value * 100)
        if from_track and speed > 0:
            put(fields, "hdg", course_deg * 100)
    elif message == "LOCAL_POSITION_NED":
        for name, value in (("vx", north), ("vy", east), ("vz", -up)):
            put(fields, name, value)
    elif message in ("GPS_RAW_INT", "GPS2_RAW"):
        put(fields, "vel", speed * 100)
        put(fields, "cog", course_deg * 100)
    elif message == "VFR_HUD":
        put(fields, "groundspeed", speed)
        put(fields, "climb", up)
        if from_track and speed > 0:
            put(fields, "heading", course_deg)
    elif message == "OPEN_DRONE_ID_LOCATION":
        put(fields, "speed_horizontal", speed * 100)
        put(fields, "speed_vertical", up * 100)
        put(fields, "direction", course_deg * 100)
