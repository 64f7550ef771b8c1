"""GeoJSON building files: reading, validation, projection and repair.

RFC 7946 FeatureCollection with OpenStreetMap tags as properties, as overpass-turbo and osmtogeojson write it. A
building is a Polygon or MultiPolygon with a `building` or `building:part` tag other than "no"; all other features are
ignored and counted. If a building has an outline and parts, all of them are kept, which errs towards more wall.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.city.building_heights import height_of
from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.core.errors import InputError, Problem
from skyrange.core.geodesy import Origin

MAX_PROBLEMS = 20
"""Problems that one error lists; further ones are only counted."""
MAX_EXTENT_DEG = 2.0
"""The flat map is inaccurate beyond this; two longitudes with opposite signs also exceed it."""


class _ShapeError(Exception):
    """A feature's coordinates are not a polygon: (value, expected)."""


def load_geojson(path: Path | str, origin: Origin | None = None) -> tuple[City, Origin]:
    """Read the city in a file, in metres from `origin`; by default from the centre of the buildings' bounding box.

    `City.counts`: `buildings`, `ignored` features, `repaired` shapes (self-crossing rings made valid), `empty` shapes
    without area that were left out, and heights by their source: `by_height`, `by_levels`, `by_default`. Raises
    `InputError` naming each bad feature by its index, all at once.
    """
    name = str(path)
    features = _features(name, Path(path))
    chosen: list[tuple[int, Mapping[str, Any], Mapping[str, Any]]] = []
    rings: list[NDArray[np.float64]] = []
    polygon_of_ring: list[int] = []
    building_of_polygon: list[int] = []
    faults: list[Problem] = []
    for index, feature in enumerate(features):
        try:
            polygons = _polygons(feature)
            if polygons is None:
                continue
            arrays = [[_ring(ring) for ring in _rings(polygon)] for polygon in polygons]
        except _ShapeError as bad:
            faults.append(Problem(f"features[{index}]", *bad.args))
            continue
        for polygon in arrays:
            rings += polygon
            polygon_of_ring += [len(building_of_polygon)] * len(polygon)
            building_of_polygon.append(len(chosen))
        chosen.append((index, feature, feature["properties"]))
    if faults:
        rest = len(faults) - MAX_PROBLEMS
        if rest > 0:
            faults[MAX_PROBLEMS:] = [Problem("features", f"{rest} more are bad", "polygons as in RFC 7946")]
        raise InputError(name, faults)
    if not rings:
        raise InputError.one(name, "features", f"{len(features)} features, no building", "polygons tagged building=…")

    degrees = np.concatenate(rings)
    west, south = degrees.min(axis=0).tolist()
    east, north = degrees.max(axis=0).tolist()
    if max(east - west, north - south) > MAX_EXTENT_DEG:
        across = f"buildings from {south:.3f}, {west:.3f} to {north:.3f}, {east:.3f} degrees"
        raise InputError.one(name, "features", across, f"one city, at most {MAX_EXTENT_DEG} degrees across")
    if origin is None:
        origin = Origin(0.5 * (south + north), 0.5 * (west + east))
    east_m, north_m = origin.to_enu(degrees[:, 1], degrees[:, 0])
    ring_of_vertex = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])
    lines = shapely.linearrings(np.column_stack((east_m, north_m)), indices=ring_of_vertex)
    shapes = shapely.polygons(lines, indices=polygon_of_ring)
    return _city(name, chosen, shapes, building_of_polygon, len(features)), origin


def _city(
    name: str,
    chosen: list[tuple[int, Mapping[str, Any], Mapping[str, Any]]],
    shapes: NDArray[np.object_],
    building_of_polygon: list[int],
    features: int,
) -> City:
    """Join polygons to buildings, repair them, and read their tags."""
    counts = dict.fromkeys(("buildings", "ignored", "repaired", "empty", "by_height", "by_levels", "by_default"), 0)
    counts["ignored"] = features - len(chosen)
    first = np.searchsorted(building_of_polygon, np.arange(len(chosen) + 1)).tolist()
    whole = [
        shapes[start] if end - start == 1 else shapely.multipolygons(shapes[start:end])
        for start, end in pairwise(first)
    ]
    valid = shapely.is_valid(whole)
    buildings = []
    used: set[str] = set()
    for (index, feature, tags), shape, is_valid in zip(chosen, whole, valid.tolist(), strict=True):
        if not is_valid:
            shape = _areas(shapely.make_valid(shape))
            counts["repaired"] += 1
        if shape.area <= 0.0:
            counts["empty"] += 1
            continue
        height_m, base_m, by = height_of(tags)
        counts[f"by_{by}"] += 1
        known = str(feature.get("id") or tags.get("@id") or f"features[{index}]")
        identity = known if known not in used else f"{known} features[{index}]"
        used.add(identity)
        buildings.append(Building(identity, height_m, shape, str(tags.get("name") or ""), base_m))
    if not buildings:
        raise InputError.one(name, "features", f"{len(chosen)} buildings without area", "polygons that enclose an area")
    counts["buildings"] = len(buildings)
    return City(buildings, name, counts)


def _areas(shape: Any) -> Any:
    """The areas of what make_valid returns, which may also contain lines and points."""
    parts = [part for part in shapely.get_parts(shape) if part.geom_type in ("Polygon", "MultiPolygon")]
    return shapely.union_all(parts)


def _features(name: str, path: Path) -> list[Any]:
    """The file's feature list; raises `InputError` if it is not a FeatureCollection."""
    try:
        document = json.loads(path.read_bytes())
    except OSError as error:
        raise InputError.one(name, "file", error.strerror or str(error), "a readable GeoJSON file") from error
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise InputError.one(name, where, error.msg, "JSON", "The file may be cut off or not be GeoJSON.") from error
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        raise InputError.one(name, "file", str(error), "JSON in UTF-8, not nested too deeply") from error
    if not isinstance(document, dict) or document.get("type") != "FeatureCollection":
        kind = document.get("type") if isinstance(document, dict) else type(document).__name__
        raise InputError.one(name, "type", repr(kind), 'a GeoJSON "FeatureCollection"')
    features = document.get("features")
    if not isinstance(features, list):
        raise InputError.one(name, "features", type(features).__name__, "a list of features")
    return features


def _polygons(feature: Any) -> list[Any] | None:
    """The polygons of a building feature, or None for any other feature."""
    if not isinstance(feature, dict):
        raise _ShapeError(type(feature).__name__, "a GeoJSON feature object")
    tags, geometry = feature.get("properties"), feature.get("geometry")
    if not isinstance(tags, dict) or not isinstance(geometry, dict):
        if tags is None or geometry is None:  # RFC 7946 section 3.2 allows both to be null
            return None
        raise _ShapeError("properties or geometry of another kind", "objects or null (RFC 7946 section 3.2)")
    if all(tags.get(key, "no") in ("no", None) for key in ("building", "building:part")):
        return None
    kind, coordinates = geometry.get("type"), geometry.get("coordinates")
    if kind not in ("Polygon", "MultiPolygon"):
        return None
    if not isinstance(coordinates, list) or not coordinates:
        raise _ShapeError(f"{kind} with coordinates {coordinates!r:.40}", "a list of rings (RFC 7946 section 3.1.6)")
    return [coordinates] if kind == "Polygon" else coordinates


def _rings(polygon: Any) -> list[Any]:
    """A polygon's rings."""
    if not isinstance(polygon, list) or not polygon:
        raise _ShapeError(f"polygon {polygon!r:.40}", "a list of rings (RFC 7946 section 3.1.6)")
    return polygon


def _ring(ring: Any) -> NDArray[np.float64]:
    """A ring as an (n, 2) array of longitude and latitude in degrees."""
    try:
        vertices = np.asarray(ring)
    except ValueError:  # ragged
        vertices = np.empty(0, dtype=object)
    if vertices.dtype.kind not in "if" or vertices.ndim != 2 or vertices.shape[1] < 2:
        raise _ShapeError(f"ring {ring!r:.40}", "a list of [longitude, latitude] positions")
    if len(vertices) < 4 or (vertices[0, :2] != vertices[-1, :2]).any():
        raise _ShapeError(
            f"ring of {len(vertices)} positions from {ring[0]} to {ring[-1]}",
            "four or more, the last equal to the first (RFC 7946 section 3.1.6)",
        )
    degrees = vertices[:, :2].astype(np.float64)
    inside = (np.abs(degrees) <= (180.0, 90.0)).all(axis=1)  # false for a NaN too
    if not inside.all():
        raise _ShapeError(f"position {ring[int(np.argmin(inside))]}", "longitude in ±180 and latitude in ±90 degrees")
    return degrees
