"""Values of F3548's bodies on the clock of the scenario: volumes, and references and details of intents."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import shapely
from uas_standards.astm.f3548.v21.api import OperationalIntentState, UssAvailabilityState

from skyrange.core import elementary_python
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import unwrap_outline, wrap_longitude
from skyrange.core.time import Epoch, Time
from skyrange.core.volumes import Volume4D

Body = dict[str, Any]

HIDDEN_OVN: Final = "Available from USS"
"""What a DSS tells instead of the OVN of another USS's intent, so that who claims airspace has asked that USS."""
NO_SUBSCRIPTION: Final = "00000000-0000-4000-8000-000000000000"
"""Subscription of an intent that has none, as the DSS of InterUSS writes it."""
MIN_ALTITUDE_M: Final = -8_000.0
MAX_ALTITUDE_M: Final = 100_000.0
"""Bounds of the standard's Altitude."""
_CORNERS: Final = 16
"""Of the polygon that is drawn around a circle."""
_EARTH_M: Final = 6_371_010.0
"""Mean radius of the earth; a circle's polygon is larger than the circle by more than the error of this."""
_MAX_RADIUS_M: Final = 100_000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstraintReference:
    """What the DSS knows of a constraint (ConstraintReference)."""

    id: str
    manager: str
    """The USS that manages it."""
    version: int
    ovn: str
    start_ns: Time
    end_ns: Time
    uss_base_url: str
    uss_availability: UssAvailabilityState = UssAvailabilityState.Unknown

    def body(self, epoch: Epoch) -> Body:
        """As JSON."""
        return {
            "id": self.id,
            "manager": self.manager,
            "version": self.version,
            "ovn": self.ovn,
            "time_start": moment_body(self.start_ns, epoch),
            "time_end": moment_body(self.end_ns, epoch, up=True),
            "uss_base_url": self.uss_base_url,
            "uss_availability": self.uss_availability.value,
        }

    @classmethod
    def of(cls, body: Mapping[str, Any], epoch: Epoch) -> Self:
        """From a checked body."""
        return cls(**cls._fields(body, epoch))

    @classmethod
    def _fields(cls, body: Mapping[str, Any], epoch: Epoch) -> dict[str, Any]:
        return {
            "id": body["id"],
            "manager": body["manager"],
            "version": body["version"],
            "ovn": body.get("ovn") or "",
            "start_ns": epoch.parse(body["time_start"]["value"]),
            "end_ns": epoch.parse(body["time_end"]["value"]),
            "uss_base_url": body["uss_base_url"],
            "uss_availability": body["uss_availability"],
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class IntentReference(ConstraintReference):
    """What the DSS knows of an operational intent (OperationalIntentReference): also its state and subscription."""

    state: OperationalIntentState
    subscription_id: str = NO_SUBSCRIPTION

    def body(self, epoch: Epoch) -> Body:
        """As JSON."""
        common = ConstraintReference.body(self, epoch)
        return {**common, "state": self.state.value, "subscription_id": self.subscription_id}

    @classmethod
    def _fields(cls, body: Mapping[str, Any], epoch: Epoch) -> dict[str, Any]:
        common = ConstraintReference._fields(body, epoch)
        return {**common, "state": body["state"], "subscription_id": body["subscription_id"]}


@dataclass(frozen=True, slots=True)
class IntentDetails:
    """What the managing USS knows of an operational intent (OperationalIntentDetails)."""

    volumes: tuple[Volume4D, ...]
    off_nominal_volumes: tuple[Volume4D, ...] = ()
    priority: int = 0

    def body(self, epoch: Epoch) -> Body:
        """As JSON."""
        return {
            "volumes": [volume_body(volume, epoch) for volume in self.volumes],
            "off_nominal_volumes": [volume_body(volume, epoch) for volume in self.off_nominal_volumes],
            "priority": self.priority,
        }

    @classmethod
    def of(cls, body: Mapping[str, Any], epoch: Epoch) -> IntentDetails:
        """From a checked body. Raises `DecodeError` for volumes that are none."""
        return cls(
            volumes_of(body.get("volumes") or (), epoch),
            volumes_of(body.get("off_nominal_volumes") or (), epoch),
            body.get("priority") or 0,
        )


def volume_body(volume: Volume4D, epoch: Epoch) -> Body:
    """A volume as JSON, its times widened to whole microseconds."""
    return {
        "volume": {
            "outline_polygon": {"vertices": [{"lat": lat, "lng": lng} for lat, lng in volume.outline]},
            "altitude_lower": {"value": volume.lower_m, "reference": "W84", "units": "M"},
            "altitude_upper": {"value": volume.upper_m, "reference": "W84", "units": "M"},
        },
        "time_start": moment_body(volume.start_ns, epoch),
        "time_end": moment_body(volume.end_ns, epoch, up=True),
    }


def volumes_of(bodies: Sequence[Mapping[str, Any]], epoch: Epoch) -> tuple[Volume4D, ...]:
    """The volumes of checked bodies. Raises `DecodeError` for one without bounds, or with wrong ones."""
    return tuple(volume_of(body, epoch, f"volume {number}") for number, body in enumerate(bodies, 1))


def volume_of(body: Mapping[str, Any], epoch: Epoch, where: str = "volume") -> Volume4D:
    """The volume of a checked body; a circle becomes the polygon around it. Raises `DecodeError`."""
    area = area_of(body, epoch, where)
    if area.lower_m is None or area.upper_m is None or area.start_ns is None or area.end_ns is None:
        raise DecodeError(f"{where}: it needs altitude_lower, altitude_upper, time_start and time_end")
    try:
        return Volume4D(area.outline, area.lower_m, area.upper_m, area.start_ns, area.end_ns)
    except ValueError as error:
        raise DecodeError(f"{where}: {error}") from error


@dataclass(frozen=True, slots=True)
class Area:
    """A part of the airspace whose heights and times may be open: `None` is no bound."""

    outline: tuple[tuple[float, float], ...]
    """(latitude, longitude) in degrees, at least three."""
    lower_m: float | None
    upper_m: float | None
    start_ns: Time | None
    end_ns: Time | None


def area_of(body: Mapping[str, Any], epoch: Epoch, where: str) -> Area:
    """What the Volume4D of a checked body encloses; a circle becomes the polygon around it. Raises `DecodeError`."""
    solid = body["volume"]
    heights = [solid.get(name) for name in ("altitude_lower", "altitude_upper")]
    for height in heights:
        if height is not None and not MIN_ALTITUDE_M <= height["value"] <= MAX_ALTITUDE_M:
            raise DecodeError(
                f"{where}: altitude {height['value']} is not within {MIN_ALTITUDE_M} to {MAX_ALTITUDE_M} m"
            )
    lower_m, upper_m = (None if height is None else height["value"] for height in heights)
    times = [body.get(name) for name in ("time_start", "time_end")]
    start_ns, end_ns = (None if instant is None else epoch.parse(instant["value"]) for instant in times)
    polygon, circle = solid.get("outline_polygon"), solid.get("outline_circle")
    if (polygon is None) == (circle is None):
        raise DecodeError(f"{where}: it needs either outline_polygon or outline_circle")
    outline = _circle(circle, where) if polygon is None else _polygon(polygon, where)
    if lower_m is not None and upper_m is not None and lower_m > upper_m:
        raise DecodeError(f"{where}: altitude_lower {lower_m} is above altitude_upper {upper_m}")
    if start_ns is not None and end_ns is not None and start_ns > end_ns:
        raise DecodeError(f"{where}: time_start is after time_end")
    return Area(outline, lower_m, upper_m, start_ns, end_ns)


def _polygon(polygon: Mapping[str, Any], where: str) -> tuple[tuple[float, float], ...]:
    """The corners of a polygon, whose edges may not cross and whose vertices may not be duplicated."""
    outline = _vertices(polygon["vertices"], where)
    if len(outline) < 3:
        raise DecodeError(f"{where}: an outline needs 3 vertices, got {len(outline)}")
    ring = unwrap_outline(outline)
    if len(set(ring)) < len(ring):
        raise DecodeError(f"{where}: an outline may not have a vertex twice, also not the first one at its end")
    if not shapely.LinearRing(ring).is_simple:
        raise DecodeError(f"{where}: the edges of an outline may not cross or touch")
    return outline


def _vertices(vertices: Sequence[Mapping[str, float]], where: str) -> tuple[tuple[float, float], ...]:
    for vertex in vertices:
        if not (-90.0 <= vertex["lat"] <= 90.0 and -180.0 <= vertex["lng"] <= 180.0):
            raise DecodeError(f"{where}: {vertex['lat']}, {vertex['lng']} is no place in degrees")
    return tuple((vertex["lat"], vertex["lng"]) for vertex in vertices)


def _circle(circle: Mapping[str, Any], where: str) -> tuple[tuple[float, float], ...]:
    """The corners of a polygon that encloses a circle."""
    center, radius = circle.get("center"), circle.get("radius")
    if center is None or radius is None or not 0.0 < radius["value"] <= _MAX_RADIUS_M:
        raise DecodeError(f"{where}: a circle needs a center, and a radius of at most {_MAX_RADIUS_M} m")
    ((lat, lng),) = _vertices([center], where)
    across_deg = math.degrees(radius["value"] / elementary_python.cos(math.pi / _CORNERS) / _EARTH_M) * 1.01
    scale = max(elementary_python.cos(math.radians(lat)), 1e-6)
    turns = [2.0 * math.pi * corner / _CORNERS for corner in range(_CORNERS)]
    ring = [
        (lat + across_deg * elementary_python.sin(turn), lng + across_deg * elementary_python.cos(turn) / scale)
        for turn in turns
    ]
    return tuple((min(max(a, -90.0), 90.0), wrap_longitude(b)) for a, b in ring)


def moment_body(time: Time, epoch: Epoch, *, up: bool = False) -> Body:
    """A moment as JSON, the microsecond at or before it, or at or after it with `up`."""
    return {"value": epoch.rfc3339(time, up=up), "format": "RFC3339"}
