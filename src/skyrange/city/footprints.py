"""Footprints of buildings: choice among a file's features, reprojection, repair and projection to local metres."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.city.building_heights import KEYS, height_of
from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.city.reading import Reading
from skyrange.core.errors import InputError
from skyrange.core.extras import describe_install
from skyrange.core.geodesy import Origin, wrap_longitude

WGS84 = "WGS 84 degrees"

_EPSG = re.compile(r"EPSG(?:/\d+/|:[\d.]*:|:)(\d{4,6})", re.IGNORECASE)
_DEGREES = re.compile(r"CRS:?84|OGC:1\.3:CRS84|EPSG:{1,2}(?:4326|4979)$|^$", re.IGNORECASE)

_FILES = re.compile(r"PARAMETERFILE|grids\s*=\s*(?!@null\b)|\binit\s*=", re.IGNORECASE)
"""What names a file or URL in the text (WKT) of a coordinate system; `nadgrids=@null` names none."""


class Projection:
    """Reprojects coordinates of one system to longitude and latitude in degrees of WGS 84."""

    def __init__(self, name: str, crs: str, *, any_order: bool = False) -> None:
        """`name` is the file, `crs` an EPSG code, URN, URL, name or WKT that pyproj knows, and that names no file.

        x is east. With `any_order`, coordinates of a geographic system may also be latitude, longitude: then
        `choose_order` is called before `to_degrees`. Raises `InputError` for an unknown system and without pyproj.
        """
        self._name = name
        self.label = WGS84
        self._transformer: Any = None
        self._system: Any = None
        self._swapped = False
        if _DEGREES.search(crs) and not any_order:
            return
        try:
            from pyproj import CRS, Transformer
            from pyproj.exceptions import CRSError
            from pyproj.network import set_network_enabled  # type: ignore[attr-defined]
        except ImportError as error:
            expected = "pyproj, which reprojects it to degrees"
            raise InputError.one(name, "coordinate system", f"{crs:.60}", expected, describe_install("city")) from error
        match = _EPSG.search(crs)
        known = f"EPSG:{match[1]}" if match and "[" not in crs else crs
        hint = f"Convert it: `ogr2ogr -f GeoJSON -s_srs EPSG:… -t_srs EPSG:4326 city.geojson {name}`."
        # PROJ opens the grid files that a definition names; its own strings and PROJJSON may name them in many ways
        if _FILES.search(known) if "[" in known else re.search("[={]", known):
            expected = "an EPSG code, URN, URL or WKT that names no file"
            raise InputError.one(name, "coordinate system", f"{crs:.60}", expected, hint)
        set_network_enabled(active=False)
        try:
            system = CRS.from_user_input(known)
            system = next((part for part in system.sub_crs_list if not part.is_vertical), system)
            self._transformer = Transformer.from_crs(system, "EPSG:4326", always_xy=True)
        except CRSError as error:
            expected = "a coordinate system that PROJ knows"
            raise InputError.one(name, "coordinate system", f"{crs:.60}", expected, hint) from error
        self._system = system
        authority = system.to_authority()
        self.label = f"{':'.join(authority)} {system.name}" if authority else system.name

    @property
    def is_degrees(self) -> bool:
        """Whether coordinates are longitude and latitude of WGS 84 already."""
        return self._transformer is None

    @property
    def is_geographic(self) -> bool:
        """Whether coordinates are degrees, of whatever system."""
        return self._system is None or bool(self._system.is_geographic)

    def choose_order(self, xy: NDArray[np.float64], *, x_is_east: bool) -> str:
        """Choose whether the (n, 2) coordinates of a geographic system have latitude or longitude first, and say why.

        It is the order in which they lie in the area of the system, or else on the earth. If they do in both, it is
        that of the system itself, or longitude first with `x_is_east`. Empty for other systems.
        """
        if self._system is None or not self._system.is_geographic or not len(xy):
            return ""
        first, second = np.median(xy, axis=0).tolist()
        by_system = self._system.axis_info[0].direction == "north"
        for place, fits in ((f"the area of {self.label}", self._has_place), ("the earth", _is_on_earth)):
            if fits(first, second) != fits(second, first):
                self._swapped = fits(first, second)
                reason = f"because in the other order they are outside {place}"
                break
        else:
            self._swapped = by_system and not x_is_east
            reason = "as in its coordinate system" if self._swapped == by_system else "as x is east"
            reason += "; to choose the other order, exchange the first two numbers of each position"
        return f"{'latitude' if self._swapped else 'longitude'} comes first in the positions of the file, {reason}"

    def _has_place(self, latitude: float, longitude: float) -> bool:
        """Whether a place is in the area in which the system is used."""
        area = self._system.area_of_use
        if area is None:
            return _is_on_earth(latitude, longitude)
        west, south, east, north = area.bounds
        width = (east - west) % 360.0 or 360.0
        return bool((longitude - west) % 360.0 <= width and south <= latitude <= north)

    def to_degrees(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) longitude and latitude of (n, 2) coordinates; infinite where there is no such place."""
        if self._transformer is None:
            return xy
        x, y = (xy[:, 1], xy[:, 0]) if self._swapped else (xy[:, 0], xy[:, 1])
        return np.column_stack(self._transformer.transform(x, y))


def _is_on_earth(latitude: float, longitude: float) -> bool:
    return abs(latitude) <= 90.0 and abs(longitude) <= 180.0


MAX_EXTENT_DEG = 2.0
"""The flat map is inaccurate beyond this."""

BUILDING_KEYS: Final = ("building", "building:part", "building_part")
_OTHER_KINDS: Final = (
    "highway",
    "landuse",
    "natural",
    "leisure",
    "waterway",
    "railway",
    "boundary",
    "place",
    "amenity",
)
"""OpenStreetMap's keys of features that are no buildings: a file that has them does not consist of buildings alone."""

Vertices = NDArray[np.float64]
"""(n, 2) or (n, 3): x, y and perhaps z in the file's coordinate system, the last vertex equal to the first."""


@dataclass(frozen=True, slots=True)
class Feature:
    """A building of a file, before it is projected and repaired."""

    where: str
    """Its place in the file, such as `features[3]`."""
    id: str
    """Its own id, or empty."""
    tags: Mapping[str, Any]
    polygons: Sequence[Sequence[Vertices]]
    """Its polygons, each as [outer ring, holes…]; walls and roofs of a solid count as polygons."""


def choose_buildings(tags: Sequence[Mapping[str, Any]], reading: Reading) -> list[str]:
    """For the tags of each polygon of a file, why it is no building, or empty if it is one.

    A feature with a `building` or `building:part` tag other than "no" is one. If no feature of the file has such a
    tag, every polygon counts as a building, unless features have OpenStreetMap's keys of other things.
    """
    keys = [{key.lower() for key in feature_tags} for feature_tags in tags]
    if any(feature_keys.intersection(BUILDING_KEYS) for feature_keys in keys):
        return [_reason(feature_tags) for feature_tags in tags]
    if any(feature_keys.intersection(_OTHER_KINDS) for feature_keys in keys):
        return ["" if feature_keys & KEYS else "without a building tag" for feature_keys in keys]
    if tags:
        reading.notes.append("no feature has a building tag, so every polygon counts as a building")
    return [""] * len(tags)


def _reason(tags: Mapping[str, Any]) -> str:
    values = [value for key, value in tags.items() if key.lower() in BUILDING_KEYS and value not in ("", None)]
    if not values:
        return "without a building tag"
    return "with building=no" if all(value == "no" for value in values) else ""


def make_city(
    name: str, features: Sequence[Feature], reading: Reading, projection: Projection | None, origin: Origin | None
) -> tuple[City, Origin]:
    """The city of some buildings, in metres from `origin`; by default from the centre of their bounding box.

    `reading` gets the counts. Raises `InputError` if there is no building, and for buildings that lie too far apart.
    """
    chosen, degrees, owners = _vertices(features, reading, projection)
    if not chosen:
        dropped = ", ".join(f"{count} {reason}" for reason, count in sorted(reading.dropped.items()))
        value = f"{reading.features} features, no building" + (f": {dropped}" if dropped else "")
        raise InputError.one(name, "features", value, "polygons tagged building=…")
    degrees = _unwrap(degrees)
    west, south = degrees.min(axis=0).tolist()
    east, north = degrees.max(axis=0).tolist()
    if max(east - west, north - south) > MAX_EXTENT_DEG:
        across = f"buildings from {south:.3f}, {west:.3f} to {north:.3f}, {east:.3f} degrees"
        hint = f"Cut a part out: `ogr2ogr -f GeoJSON -t_srs EPSG:4326 -spat WEST SOUTH EAST NORTH city.geojson {name}`."
        raise InputError.one(name, "features", across, f"one city, at most {MAX_EXTENT_DEG} degrees across", hint)
    if origin is None:
        origin = Origin(0.5 * (south + north), wrap_longitude(0.5 * (west + east)))
    east_m, north_m = origin.to_enu(degrees[:, 1], degrees[:, 0])
    lines = shapely.linearrings(np.column_stack((east_m, north_m)), indices=owners.ring_of_vertex)
    shapes = shapely.polygons(lines, indices=owners.polygon_of_ring)
    return _build(name, chosen, shapes, owners.building_of_polygon, reading), origin


def _unwrap(degrees: Vertices) -> Vertices:
    """Vertices without a jump of longitude at the date line (RFC 7946, 3.1.9): within half a turn of the first one."""
    away = degrees[:, 0] - degrees[0, 0]
    if np.abs(away).max() <= 180.0:
        return degrees
    turns = np.where(away > 180.0, -360.0, np.where(away < -180.0, 360.0, 0.0))
    unwrapped: Vertices = degrees + np.column_stack((turns, np.zeros(len(turns))))
    return unwrapped


@dataclass(frozen=True, slots=True)
class _Owners:
    ring_of_vertex: NDArray[np.int64]
    polygon_of_ring: list[int]
    building_of_polygon: list[int]


def _vertices(
    chosen: Sequence[Feature], reading: Reading, projection: Projection | None
) -> tuple[list[Feature], Vertices, _Owners]:
    """All vertices in degrees; features without a place on earth are left out and counted."""
    kept: list[Feature] = []
    rings: list[Vertices] = []
    polygon_of_ring: list[int] = []
    building_of_polygon: list[int] = []
    for feature in chosen:
        feature_rings = [ring for polygon in feature.polygons for ring in polygon]
        flat = np.concatenate([ring[:, :2] for ring in feature_rings]) if feature_rings else np.empty((0, 2))
        degrees = projection.to_degrees(flat) if projection is not None else flat
        if not len(degrees):
            reading.dropped["without geometry"] += 1
            continue
        if not ((np.abs(degrees) <= (180.0, 90.0)).all()):  # false for a NaN too
            reading.dropped["outside the coordinate system"] += 1
            continue
        ends = np.cumsum([len(ring) for ring in feature_rings])[:-1]
        rings += np.split(degrees, ends)
        for polygon in feature.polygons:
            polygon_of_ring += [len(building_of_polygon)] * len(polygon)
            building_of_polygon.append(len(kept))
        kept.append(feature)
    whole = np.concatenate(rings) if rings else np.empty((0, 2))
    ring_of_vertex = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])
    return kept, whole, _Owners(ring_of_vertex, polygon_of_ring, building_of_polygon)


def _build(
    name: str, chosen: Sequence[Feature], shapes: NDArray[Any], building_of_polygon: Sequence[int], reading: Reading
) -> City:
    """Join polygons to buildings, repair them, and read their tags."""
    first = np.searchsorted(building_of_polygon, np.arange(len(chosen) + 1)).tolist()
    buildings = []
    used: set[str] = set()
    for feature, (start, end) in zip(chosen, pairwise(first), strict=True):
        span_m = _span_m(feature)
        shape = shapes[start] if end - start == 1 else shapely.multipolygons(shapes[start:end])
        if span_m > 0.0 and end - start > 1:
            shape = _shadow(shapes[start:end])  # walls, roofs and ground of a solid
        elif not shapely.is_valid(shape):
            shape = _areas(shapely.make_valid(shape))
            reading.repaired += 1
        if shape.area <= 0.0:
            reading.dropped["without area"] += 1
            continue
        height = height_of(feature.tags, span_m)
        reading.count_height(height)
        known = feature.id or feature.where
        identity = known if known not in used else f"{known} {feature.where}"
        used.add(identity)
        label = str(feature.tags.get("name") or "")
        buildings.append(Building(identity, height.height_m, shape, label, height.base_m))
    if not buildings:
        raise InputError.one(name, "features", f"{len(chosen)} buildings without area", "polygons that enclose an area")
    reading.kept = len(buildings)
    return City(buildings, name, reading)


def _span_m(feature: Feature) -> float:
    """Metres between the lowest and the highest vertex; 0 for coordinates without heights."""
    heights = [ring[:, 2] for polygon in feature.polygons for ring in polygon if ring.shape[1] > 2]
    if not heights:
        return 0.0
    z = np.concatenate(heights)
    z = z[np.isfinite(z)]
    return float(z.max() - z.min()) if len(z) else 0.0


def _shadow(surfaces: NDArray[Any]) -> Any:
    """What the surfaces of a solid cover, seen from above."""
    valid = [surface if shapely.is_valid(surface) else _areas(shapely.make_valid(surface)) for surface in surfaces]
    return shapely.union_all([surface for surface in valid if surface.area > 0.0])


def _areas(shape: Any) -> Any:
    """The areas of what make_valid returns, which may also contain lines and points."""
    parts = [part for part in shapely.get_parts(shape) if part.geom_type in ("Polygon", "MultiPolygon")]
    return shapely.union_all(parts)
