"""False position in telemetry: an offset, or a track of the attacker's own, in all messages that tell a position.

Barometric pressure (SCALED_PRESSURE), the distance to the next waypoint (NAV_CONTROLLER_OUTPUT) and the rangefinder
stay true: a receiver that compares them can find the lie.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import atan2, degrees, hypot
from typing import Any, Final, Literal

from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Place
from skyrange.attack.telemetry.alteration import CONTROLS, TelemetryLinks, alter_telemetry, put, threat
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.params import Enu, refuse
from skyrange.core.errors import Problem
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time

_POSITION: Final = int(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
_GPS: Final = int(mav.MAVLINK_MSG_ID_GPS_RAW_INT)
_GPS2: Final = int(mav.MAVLINK_MSG_ID_GPS2_RAW)
_LOCAL: Final = int(mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
_HUD: Final = int(mav.MAVLINK_MSG_ID_VFR_HUD)
_DRONE_ID: Final = int(mav.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION)

_PLACED: Final[Mapping[int, tuple[str, str]]] = {
    _POSITION: ("lat", "lon"),
    _GPS: ("lat", "lon"),
    _GPS2: ("lat", "lon"),
    int(mav.MAVLINK_MSG_ID_AHRS2): ("lat", "lng"),
    int(mav.MAVLINK_MSG_ID_TERRAIN_REPORT): ("lat", "lon"),
    _DRONE_ID: ("latitude", "longitude"),
}
"""Fields with latitude and longitude in 1e-7 degrees; both 0 without a position."""
_HEIGHTS: Final[Mapping[int, tuple[tuple[str, float], ...]]] = {
    _POSITION: (("alt", 1e3), ("relative_alt", 1e3)),
    _GPS: (("alt", 1e3), ("alt_ellipsoid", 1e3)),
    _GPS2: (("alt", 1e3), ("alt_ellipsoid", 1e3)),
    int(mav.MAVLINK_MSG_ID_AHRS2): (("altitude", 1.0),),
    int(mav.MAVLINK_MSG_ID_TERRAIN_REPORT): (("current_height", 1.0),),
    _DRONE_ID: (("altitude_barometric", 1.0), ("altitude_geodetic", 1.0), ("height", 1.0)),
    _LOCAL: (("z", -1.0),),
    _HUD: (("alt", 1.0),),
}
"""Fields with heights, and their units per metre."""
_NO_HEIGHT_M: Final = -1000.0
"""OPEN_DRONE_ID_LOCATION: an unknown height."""
_TRUE: Final = (0.0, 0.0, 0.0)


class FalsePosition(TelemetryLinks):
    """The aircraft appears elsewhere: at an offset from its position, or on a track of the attacker's."""

    form: Literal["offset", "track"] = Field(
        default="offset",
        description="offset: the true position and offset_m; track: positions along a line, whatever the aircraft "
        "does.",
    )
    offset_m: Enu = Field(
        default=_TRUE, description="Offset at the start of the attack, [east, north, up] in metres; form = 'offset'."
    )
    drift_mps: Enu = Field(
        default=_TRUE,
        description="Growth of the offset, [east, north, up] in m/s; reported velocities agree. form = 'offset'.",
    )
    at: Enu | None = Field(
        default=None,
        description="Claimed position at the start of the attack, [east_m, north_m, up_m] in metres from the origin or "
        "the attack's anchor; form = 'track'.",
    )
    velocity_mps: Enu = Field(default=_TRUE, description="Claimed velocity, [east, north, up] in m/s; form = 'track'.")

    @model_validator(mode="after")
    def _fits_its_form(self) -> FalsePosition:
        faults = []
        if self.form == "track" and self.at is None:
            faults.append(Problem("at", "missing", "where the track begins, because form = 'track'"))
        if self.form == "offset" and self.at is not None:
            faults.append(Problem("at", repr(list(self.at)), "no position with form = 'offset'", "Use offset_m."))
        if self.form == "offset" and self.offset_m == _TRUE and self.drift_mps == _TRUE:
            faults.append(Problem("offset_m", repr(list(_TRUE)), "an offset or a drift other than 0"))
        if faults:
            raise refuse(*faults)
        return self


@dataclass(slots=True)
class PositionAlteration:
    """Moves reported positions and velocities; heights above home move as heights above sea level do."""

    origin: Origin
    offset_m: Place
    rate_mps: Place
    at: Place | None
    """Where a track begins; `None`: an offset."""
    place: Place | None = None
    """The last true position reported, metres from the origin."""
    velocity: Place = _TRUE
    """The last true velocity reported, m/s east, north and up."""

    @property
    def messages(self) -> frozenset[int]:
        """All messages with a position."""
        return frozenset(_HEIGHTS)

    def alter(self, since_ns: Time, number: int, fields: Any) -> bool:
        """See `Alteration`."""
        if number == _POSITION:
            east_m, north_m = self.origin.enu_of(fields["lat"] * 1e-7, fields["lon"] * 1e-7)
            self.place = (east_m, north_m, fields["alt"] * 1e-3 - self.origin.alt_msl_m)
            self.velocity = (fields["vy"] * 1e-2, fields["vx"] * 1e-2, -fields["vz"] * 1e-2)
        if since_ns < 0 or (self.at is not None and self.place is None):
            return False
        seconds = since_ns / NS_PER_S
        first, rate = self.at or self.offset_m, self.rate_mps
        shift = (first[0] + rate[0] * seconds, first[1] + rate[1] * seconds, first[2] + rate[2] * seconds)
        if self.at is not None and self.place is not None:
            shift = (shift[0] - self.place[0], shift[1] - self.place[1], shift[2] - self.place[2])
            _set_velocity(number, fields, rate, True)
        elif rate != _TRUE and self.place is not None:
            true = self.velocity
            _set_velocity(number, fields, (true[0] + rate[0], true[1] + rate[1], true[2] + rate[2]), False)
        self._move(number, fields, shift)
        return True

    def _move(self, number: int, fields: Any, by_m: Place) -> None:
        if number == _LOCAL:
            put(fields, "x", fields["x"] + by_m[1])
            put(fields, "y", fields["y"] + by_m[0])
        elif number in _PLACED:
            lat, lon = _PLACED[number]
            if not (fields[lat] or fields[lon]):
                return
            east_m, north_m = self.origin.enu_of(fields[lat] * 1e-7, fields[lon] * 1e-7)
            lat_deg, lon_deg = self.origin.geodetic_of(east_m + by_m[0], north_m + by_m[1])
            put(fields, lat, lat_deg * 1e7)
            put(fields, lon, lon_deg * 1e7)
        for name, units in _HEIGHTS[number]:
            unknown = name == "alt_ellipsoid" and fields[name] == 0
            if not unknown and not (number == _DRONE_ID and fields[name] == _NO_HEIGHT_M):
                put(fields, name, fields[name] + by_m[2] * units)


def _set_velocity(number: int, fields: Any, velocity: Place, from_track: bool) -> None:
    """Write a velocity (m/s east, north and up) into a message; the course too, and the heading of a false track."""
    east, north, up = velocity
    speed = hypot(east, north)
    course_deg = degrees(atan2(east, north)) % 360.0
    if number == _POSITION:
        for name, value in (("vx", north), ("vy", east), ("vz", -up)):
            put(fields, name, value * 100)
        if from_track and speed > 0:
            put(fields, "hdg", course_deg * 100)
    elif number == _LOCAL:
        for name, value in (("vx", north), ("vy", east), ("vz", -up)):
            put(fields, name, value)
    elif number in (_GPS, _GPS2):
        put(fields, "vel", speed * 100)
        put(fields, "cog", course_deg * 100)
    elif number == _HUD:
        put(fields, "groundspeed", speed)
        put(fields, "climb", up)
        if from_track and speed > 0:
            put(fields, "heading", course_deg)
    elif number == _DRONE_ID:
        put(fields, "speed_horizontal", speed * 100)
        put(fields, "speed_vertical", up * 100)
        put(fields, "direction", course_deg * 100)


def make(params: FalsePosition, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or that carry no telemetry."""
    rate = params.velocity_mps if params.form == "track" else params.drift_mps
    alteration = PositionAlteration(context.origin, params.offset_m, rate, params.at)
    shown = {} if params.at is None else {"false position": params.at}
    return replace(alter_telemetry(params.links, context, alteration), shown=shown)


POSITION = AttackPlugin(
    FalsePosition,
    make,
    "Alters the position in telemetry, in all messages that tell one.",
    technique="T0856",
    surface=("gcs", "log", "autopilot", "rid_data"),
    persists="acts",
    effect="receivers of telemetry believe that the aircraft is elsewhere, and guided targets, Remote ID or avoidance "
    "follow",
    threat=threat("the messages that tell a position; the true position from the frames that pass"),
    controls=CONTROLS,
)
