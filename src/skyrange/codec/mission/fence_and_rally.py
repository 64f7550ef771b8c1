"""Fence and rally points of a QGroundControl `.plan` file, as the mission items that QGroundControl uploads.

After https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html and `sendToVehicle` of
QGroundControl's GeoFenceManager and RallyPointManager: polygons vertex by vertex with their count in param1, circles
with their radius there, the breach return point last; fences at MAV_FRAME_GLOBAL, the other two above home.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import groupby

from pymavlink.dialects.v20 import ardupilotmega as mav

from skyrange.codec.mission.items import MissionItem, ProblemCollector

POLYGONS = {
    True: int(mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION),
    False: int(mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION),
}
"""The command of a vertex, by whether the aircraft has to stay inside."""
CIRCLES = {True: int(mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION), False: int(mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)}
RETURN = int(mav.MAV_CMD_NAV_FENCE_RETURN_POINT)
RALLY = int(mav.MAV_CMD_NAV_RALLY_POINT)
ZONE_COMMANDS = frozenset({*POLYGONS.values(), *CIRCLES.values(), RETURN, RALLY})
"""The commands of fences and rally points, which are uploaded apart from the mission."""
FENCE_VERSIONS = (1, 2)
"""Of `geoFence`, which QGroundControl reads (GeoFenceController.cc)."""
RALLY_VERSIONS = (1, 2)
"""Of `rallyPoints` (RallyPointController.cc); both have the same points."""
MAX_VERTICES = 255
"""Of one polygon: ArduPilot counts them in 8 bits (AC_PolyFence_loader.h)."""
MAX_RALLY_ALT_M = 32_767
"""ArduPilot stores whole metres in 16 bits (AP_Rally.h, RallyLocation)."""

Items = tuple[MissionItem, ...]
Place = tuple[float, float]
"""Latitude and longitude in degrees."""


def polygon(corners: Sequence[Place], *, inclusion: bool) -> Items:
    """The items of a polygon."""
    return tuple(_item(POLYGONS[inclusion], place, float(len(corners))) for place in corners)


def circle(centre: Place, radius_m: float, *, inclusion: bool) -> Items:
    """The item of a circle."""
    return (_item(CIRCLES[inclusion], centre, radius_m),)


def return_point(place: Place, alt_m: float) -> Items:
    """The item of the point to which a breach leads back, `alt_m` above home."""
    return (_item(RETURN, place, 0.0, alt_m),)


def rally_point(place: Place, alt_m: float) -> MissionItem:
    """The item of a rally point, `alt_m` above home."""
    return _item(RALLY, place, 0.0, alt_m)


def _item(command: int, place: Place, param1: float, alt_m: float | None = None) -> MissionItem:
    frame = mav.MAV_FRAME_GLOBAL if alt_m is None else mav.MAV_FRAME_GLOBAL_RELATIVE_ALT
    return MissionItem(int(frame), command, param1, 0.0, 0.0, 0.0, *place, alt_m or 0.0, autocontinue=False)


# ---------------------------------------------------------------- files


def parse_fence(fence: Mapping[str, object] | None, problems: ProblemCollector) -> Items:
    """The items of a `geoFence` object; what is wrong in it goes to `problems`."""
    if fence is None:
        return ()
    _check_version(fence, "geoFence", FENCE_VERSIONS, problems)
    items: list[MissionItem] = []
    if fence.get("polygon"):  # of version 1, which has this one alone
        items += _polygon_of(fence["polygon"], "geoFence.polygon", problems, inclusion=True)
    for where, entry in _entries(fence, "polygons", problems):
        inclusion = _inclusion(entry, where, problems)
        items += _polygon_of(entry.get("polygon"), f"{where}.polygon", problems, inclusion=inclusion)
    for where, entry in _entries(fence, "circles", problems):
        inclusion, round_ = _inclusion(entry, where, problems), entry.get("circle")
        if not isinstance(round_, dict):
            problems.add(f"{where}.circle", round_, "an object with center and radius")
            continue
        _check_version(round_, f"{where}.circle", (1,), problems)
        place = _numbers(round_.get("center"), 2, f"{where}.circle.center", problems)
        radius_m = _number(round_.get("radius"))
        if radius_m is None or radius_m <= 0.0:
            problems.add(f"{where}.circle.radius", round_.get("radius"), "a radius above 0 m")
        elif place:
            items += circle((place[0], place[1]), radius_m, inclusion=inclusion)
    if fence.get("breachReturn") is not None:
        place = _numbers(fence["breachReturn"], 3, "geoFence.breachReturn", problems)
        if place:
            items += return_point((place[0], place[1]), place[2])
    return tuple(items)


def parse_rally(rally: Mapping[str, object] | None, problems: ProblemCollector) -> Items:
    """The items of a `rallyPoints` object; what is wrong in it goes to `problems`."""
    if rally is None:
        return ()
    _check_version(rally, "rallyPoints", RALLY_VERSIONS, problems)
    points = rally.get("points", [])
    if not isinstance(points, list):
        problems.add("rallyPoints.points", points, "a list of [latitude, longitude, altitude]")
        return ()
    items = []
    for number, point in enumerate(points):
        where = f"rallyPoints.points[{number}]"
        place = _numbers(point, 3, where, problems)
        if place and abs(place[2]) > MAX_RALLY_ALT_M:
            problems.add(where, place[2], f"an altitude within ±{MAX_RALLY_ALT_M} m")
        elif place:
            items.append(rally_point((place[0], place[1]), place[2]))
    return tuple(items)


def format_fence(items: Items) -> dict[str, object]:
    """The `geoFence` object of items."""
    inside = {command: inclusion for kinds in (POLYGONS, CIRCLES) for inclusion, command in kinds.items()}
    circles = [
        {"circle": {"center": [item.x, item.y], "radius": item.param1}, "inclusion": inside[item.command], "version": 1}
        for item in items
        if item.command in CIRCLES.values()
    ]
    polygons = [
        {"inclusion": inside[ring[0].command], "polygon": [[vertex.x, vertex.y] for vertex in ring], "version": 1}
        for ring in rings_of(items)
    ]
    geo_fence: dict[str, object] = {"circles": circles, "polygons": polygons, "version": 2}
    for item in items:
        if item.command == RETURN:
            geo_fence["breachReturn"] = [item.x, item.y, item.z]
    return geo_fence


def format_rally(items: Items) -> dict[str, object]:
    """The `rallyPoints` object of items."""
    return {"points": [[item.x, item.y, item.z] for item in items], "version": 2}


def rings_of(items: Items) -> list[Items]:
    """The vertices of each polygon."""
    rings: list[Items] = []
    for command, group in groupby(items, lambda item: item.command):
        vertices = tuple(group) if command in POLYGONS.values() else ()
        while vertices:
            size = max(int(vertices[0].param1), 1)
            rings.append(vertices[:size])
            vertices = vertices[size:]
    return rings


def _polygon_of(corners: object, where: str, problems: ProblemCollector, *, inclusion: bool) -> Items:
    if not isinstance(corners, list) or not 3 <= len(corners) <= MAX_VERTICES:
        problems.add(where, corners, f"3 to {MAX_VERTICES} corners, each [latitude, longitude]")
        return ()
    places = [_numbers(corner, 2, f"{where}[{number}]", problems) for number, corner in enumerate(corners)]
    if not all(places):
        return ()
    return polygon([(place[0], place[1]) for place in places if place], inclusion=inclusion)


def _check_version(part: Mapping[str, object], where: str, known: tuple[int, ...], problems: ProblemCollector) -> None:
    """Add a problem for a version that is not `known`; a part without one is read as the newest."""
    version = part.get("version", known[-1])
    if version not in known or isinstance(version, bool):
        problems.add(f"{where}.version", version, f"one of {known}" if len(known) > 1 else f"{known[0]}")


def _entries(fence: Mapping[str, object], key: str, problems: ProblemCollector) -> list[tuple[str, dict[str, object]]]:
    listed = fence.get(key, [])
    if not isinstance(listed, list):
        problems.add(f"geoFence.{key}", listed, "a list")
        return []
    entries = []
    for number, entry in enumerate(listed):
        where = f"geoFence.{key}[{number}]"
        if isinstance(entry, dict):
            _check_version(entry, where, (1,), problems)
            entries.append((where, entry))
        else:
            problems.add(where, entry, "an object")
    return entries


def _inclusion(entry: Mapping[str, object], where: str, problems: ProblemCollector) -> bool:
    value = entry.get("inclusion", "missing")
    if not isinstance(value, bool):
        problems.add(f"{where}.inclusion", value, "true or false")
    return value is True


def _numbers(value: object, count: int, where: str, problems: ProblemCollector) -> list[float]:
    """Latitude, longitude and perhaps an altitude; an empty list, and a problem, for anything else."""
    parsed = [_number(item) for item in value] if isinstance(value, list) else []
    numbers = [number for number in parsed if number is not None]
    if len(numbers) != count or len(parsed) != count or abs(numbers[0]) > 90.0 or abs(numbers[1]) > 180.0:
        names = "latitude, longitude" + ", altitude" * (count == 3)
        problems.add(where, value, f"[{names}] in degrees{' and metres' * (count == 3)}")
        return []
    return numbers


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
