"""JSON documents with a list of GeoJSON features, which are compacted one by one while the text is read.

Coordinates as lists of lists take several times the memory of the text; only one feature has them at a time.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

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
            one, at = decoder.raw_decode(text, at)
            features.append(compact_feature(one))
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
        found = text[at : at + 1]
        if found == end:
            return at + 1
        if found != ",":
            raise json.JSONDecodeError("Expecting ',' delimiter", text, at)
        at = _skip(text, at + 1)


def _skip(text: str, at: int) -> int:
    space = _SPACE.match(text, at)
    return space.end() if space is not None else at


def compact_feature(feature: Any) -> Any:
    """A GeoJSON feature with its rings as arrays, without members that are not used; anything else is unchanged."""
    if not isinstance(feature, dict) or feature.get("type") != "Feature":
        return feature
    found = {name: feature[name] for name in ("type", "id", "properties", "geometry") if name in feature}
    tags, geometry = found.get("properties"), found.get("geometry")
    if isinstance(tags, dict):  # the decoder shares the text of keys only within a feature
        found["properties"] = {sys.intern(key): value for key, value in tags.items()}
    if isinstance(geometry, dict):
        found["geometry"] = _compact_geometry(geometry)
    return found


def _compact_geometry(geometry: Mapping[str, Any]) -> dict[str, Any]:
    found = {name: geometry[name] for name in ("type", "coordinates") if name in geometry}
    kind = found.get("type")
    depth = _RINGS.get(kind) if isinstance(kind, str) else None
    if depth is None:
        found.pop("coordinates", None)
    elif isinstance(found.get("coordinates"), list):
        found["coordinates"] = _compact_rings(found["coordinates"], depth)
    return found


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
