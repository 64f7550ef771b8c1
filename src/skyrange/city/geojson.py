"""GeoJSON building files: FeatureCollections and sequences of features, read feature by feature.

Properties are attributes of buildings as overpass-turbo, osmtogeojson and cities write them (`city.building_heights`).
A `crs` member of the older GeoJSON of 2008 is read. If a building has an outline and parts, all of them are kept, which
errs towards more wall.

Files are validated by RFC 7946 and RFC 8142. Features are compacted one by one while the text is read: coordinates as
lists of lists take several times the memory of the text, and only one feature has them at a time.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.city.footprints import Feature, Projection, choose_buildings, make_city
from skyrange.city.reading import Reading
from skyrange.core.errors import InputError, Problem
from skyrange.core.files import MIB, read_input
from skyrange.core.geodesy import Origin

_SPACE: Final = re.compile(r"[ \t\n\r]*+")
_RINGS: Final = {"Polygon": 1, "MultiPolygon": 2}
"""Depth at which the coordinates of a geometry have rings."""


def parse_document(text: str) -> Any:
    """The JSON document in a text, as `json.loads` has it; the `features` of an object are compacted.

    Raises `json.JSONDecodeError`.
    """
    at = _skip(text, 0)
    if text[at : at + 1] != "{":
        return json.loads(text)
    decoder = json.JSONDecoder()
    document: dict[str, Any] = {}

    def member(at: int) -> int:
        if text[at : at + 1] != '"':
            raise json.JSONDecodeError("Expecting property name enclosed in double quotes", text, at)
        key, at = decoder.raw_decode(text, at)
        at = _skip(text, at)
        if text[at : at + 1] != ":":
            raise json.JSONDecodeError("Expecting ':' delimiter", text, at)
        at = _skip(text, at + 1)
        if key != "features" or text[at : at + 1] != "[":
            document[key], at = decoder.raw_decode(text, at)
            return at
        features: list[Any] = []
        document[key] = features

        def feature(at: int) -> int:
            value, at = decoder.raw_decode(text, at)
            features.append(compact_feature(value))
            return at

        return _scan(text, at, "]", feature)

    at = _skip(text, _scan(text, at, "}", member))
    if at != len(text):
        raise json.JSONDecodeError("Extra data", text, at)
    return document


def _scan(text: str, at: int, end: str, read: Callable[[int], int]) -> int:
    """Read what stands between a bracket and its `end`, separated by commas; return the place behind it."""
    at = _skip(text, at + 1)
    if text[at : at + 1] == end:
        return at + 1
    while True:
        at = _skip(text, read(at))
        character = text[at : at + 1]
        if character == end:
            return at + 1
        if character != ",":
            raise json.JSONDecodeError("Expecting ',' delimiter", text, at)
        at = _skip(text, at + 1)


def _skip(text: str, at: int) -> int:
    space = _SPACE.match(text, at)
    return space.end() if space is not None else at


def compact_feature(feature: Any) -> Any:
    """A GeoJSON feature with its rings as arrays, without members that are not used; anything else is unchanged."""
    if not isinstance(feature, dict) or feature.get("type") != "Feature":
        return feature
    compact = {name: feature[name] for name in ("type", "id", "properties", "geometry") if name in feature}
    tags, geometry = compact.get("properties"), compact.get("geometry")
    if isinstance(tags, dict):  # the decoder shares the text of keys only within a feature
        compact["properties"] = {sys.intern(key): value for key, value in tags.items()}
    if isinstance(geometry, dict):
        compact["geometry"] = _compact_geometry(geometry)
    return compact


def _compact_geometry(geometry: Mapping[str, Any]) -> dict[str, Any]:
    compact = {name: geometry[name] for name in ("type", "coordinates") if name in geometry}
    kind = compact.get("type")
    depth = _RINGS.get(kind) if isinstance(kind, str) else None
    if depth is None:
        compact.pop("coordinates", None)
    elif isinstance(compact.get("coordinates"), list):
        compact["coordinates"] = _compact_rings(compact["coordinates"], depth)
    return compact


def _compact_rings(part: Any, depth: int) -> Any:
    if not isinstance(part, list):
        return part
    if depth:
        return [_compact_rings(inner, depth - 1) for inner in part]
    vertices = ring_vertices(part)
    return part if vertices is None else vertices


def ring_vertices(ring: Any) -> NDArray[Any] | None:
    """The positions of a ring as an (n, 2) array or wider; `None` where it is no list of positions of numbers."""
    try:
        vertices = np.asarray(ring)
    except ValueError:  # ragged
        return None
    return vertices if vertices.dtype.kind in "if" and vertices.ndim == 2 and vertices.shape[1] >= 2 else None


_OTHER_TYPES: Final = (
    "Feature", "GeometryCollection", "Polygon", "MultiPolygon", "Topology", "CityJSON", "CityJSONFeature", "list",
)  # fmt: skip
"""What is named in the error for a document of another type; the rest is not quoted, as the file may be any."""
MAX_PROBLEMS = 20
"""Problems that one error lists; further ones are only counted."""
MAX_FILE_BYTES = 512 * MIB


class _ShapeError(Exception):
    """A feature's coordinates are not a polygon: (value, expected)."""


def read_collection(name: str, document: Any, origin: Origin | None, kind: str = "GeoJSON") -> tuple[City, Origin]:
    """The city of a FeatureCollection; `kind` is the format's name in the reading."""
    if not isinstance(document, dict) or document.get("type") != "FeatureCollection":
        known = document.get("type") if isinstance(document, dict) else type(document).__name__
        shown = repr(known) if known in _OTHER_TYPES else "missing" if known is None else "another"
        raise InputError.one(name, "type", shown, 'a GeoJSON "FeatureCollection"')
    rows = document.get("features")
    if not isinstance(rows, list):
        raise InputError.one(name, "features", type(rows).__name__, "a list of features")
    projection = _projection(name, document.get("crs"))
    reading = Reading(kind, projection.label, len(rows))
    features: list[Feature] = []
    problems: list[Problem] = []
    polygonal: list[tuple[int, Mapping[str, Any]]] = []
    for index, row in enumerate(rows):
        try:
            reason = _check_feature(row)
        except _ShapeError as bad:
            problems.append(Problem(f"features[{index}]", *bad.args))
            continue
        if reason:
            reading.dropped[reason] += 1
        else:
            polygonal.append((index, row["properties"] or {}))
    reasons = choose_buildings([tags for _, tags in polygonal], reading)
    for (index, tags), reason in zip(polygonal, reasons, strict=True):
        if reason:
            reading.dropped[reason] += 1
            continue
        row, where = rows[index], f"features[{index}]"
        try:
            polygons = _polygons(row["geometry"])
            arrays = [[_ring(ring, projection) for ring in _rings(polygon)] for polygon in polygons]
        except _ShapeError as bad:
            problems.append(Problem(where, *bad.args))
            continue
        features.append(Feature(where, str(row.get("id") or tags.get("@id") or ""), tags, arrays))
    problems.sort(key=lambda fault: int(fault.where[len("features[") : -1]))
    if problems:
        rest = len(problems) - MAX_PROBLEMS
        if rest > 0:
            problems[MAX_PROBLEMS:] = [Problem("features", f"{rest} more are bad", "polygons as in RFC 7946")]
        raise InputError(name, problems)
    return make_city(name, features, reading, projection, origin)


def read_json(name: str, path: Path) -> Any:
    """The JSON document in a file, with compact features; raises `InputError` if it is none."""
    try:
        return parse_document(
            _decode(read_input(path, name, max_bytes=MAX_FILE_BYTES, expected="a readable GeoJSON file"))
        )
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise InputError.one(name, where, error.msg, "JSON", "The file may be cut off or not be GeoJSON.") from error
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        raise InputError.one(name, "file", str(error), "JSON in UTF-8, not nested too deeply") from error


def _decode(data: bytes) -> str:
    return data.decode(json.detect_encoding(data), "surrogatepass")


def read_json_lines(name: str, path: Path) -> list[Any]:
    """The JSON documents of a sequence, one a line, with or without record separators (RFC 8142)."""
    documents = []
    number = 0
    try:
        for line in read_input(path, name, max_bytes=MAX_FILE_BYTES, expected="a readable file").splitlines():
            number += 1
            text = line.strip(b"\x1e \t\r\n")
            if text:
                documents.append(compact_feature(json.loads(text)))
    except (ValueError, RecursionError) as error:
        where, hint = f"line {number}", "The file may be cut off, or be JSON on several lines: name it .geojson."
        raise InputError.one(name, where, str(error), "one JSON document a line", hint) from error
    return documents


def _projection(name: str, crs: Any) -> Projection:
    """The coordinate system that a `crs` member names (GeoJSON 2008, section 3); degrees without one."""
    if crs is None:
        return Projection(name, "")
    named = crs.get("properties") if isinstance(crs, dict) else None
    value = named.get("name") if isinstance(named, dict) else None
    if not isinstance(value, str):
        raise InputError.one(name, "crs", f"{crs!r:.60}", 'an object with the name of a system, or no "crs"')
    return Projection(name, value)


def _check_feature(feature: Any) -> str:
    """Empty for a feature with polygons, otherwise why it has none."""
    if not isinstance(feature, dict):
        raise _ShapeError(type(feature).__name__, "a GeoJSON feature object")
    for value in (feature.get("properties"), feature.get("geometry")):
        if value is not None and not isinstance(value, dict):  # RFC 7946 section 3.2 allows both to be null
            raise _ShapeError("properties or geometry of another kind", "objects or null (RFC 7946 section 3.2)")
    if feature.get("geometry") is None:
        return "without geometry"
    feature.setdefault("properties", None)
    kind = feature["geometry"].get("type")
    if kind in ("Polygon", "MultiPolygon"):
        return ""
    return f"of type {kind}" if isinstance(kind, str) else "of no type"


def _polygons(geometry: Mapping[str, Any]) -> list[Any]:
    """The polygons of a geometry, each a list of rings."""
    kind, coordinates = geometry["type"], geometry.get("coordinates")
    if not isinstance(coordinates, list) or not coordinates:
        raise _ShapeError(f"{kind} with coordinates {coordinates!r:.40}", "a list of rings (RFC 7946 section 3.1.6)")
    return [coordinates] if kind == "Polygon" else coordinates


def _rings(polygon: Any) -> list[Any]:
    """A polygon's rings."""
    if not isinstance(polygon, list) or not polygon:
        raise _ShapeError(f"polygon {polygon!r:.40}", "a list of rings (RFC 7946 section 3.1.6)")
    return polygon


def _ring(ring: Any, projection: Projection) -> NDArray[np.float64]:
    """A ring as an (n, 2) or (n, 3) array."""
    vertices = ring_vertices(ring)
    if vertices is None:
        raise _ShapeError(f"ring {ring!r:.40}", "a list of [longitude, latitude] positions")
    if len(vertices) < 4 or (vertices[0, :2] != vertices[-1, :2]).any():
        raise _ShapeError(
            f"ring of {len(vertices)} positions from {_spell(vertices[0])} to {_spell(vertices[-1])}",
            "four or more, the last equal to the first (RFC 7946 section 3.1.6)",
        )
    places = vertices[:, :3].astype(np.float64)
    if projection.is_degrees:
        inside = (np.abs(places[:, :2]) <= (180.0, 90.0)).all(axis=1)  # false for a NaN too
        if not inside.all():
            hint = "" if np.isnan(places[:, :2]).any() else '; or a "crs" member that names their system'
            raise _ShapeError(
                f"position {_spell(vertices[int(np.argmin(inside))])}",
                f"longitude in ±180 and latitude in ±90 degrees{hint}",
            )
    return places


def _spell(position: NDArray[Any]) -> str:
    return f"[{', '.join(f'{part:.10g}' for part in position.tolist())}]"
