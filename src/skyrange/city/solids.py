"""CityJSON and CityGML: buildings as solids or surfaces with 3-D coordinates, and their attributes.

Of each building the surfaces of one level of detail are read, the lowest that has heights, otherwise the footprint.
What they cover, seen from above, becomes the footprint (`city.footprints`). CityJSON 1.0 to 2.0, also as a sequence of
features (CityJSONSeq); CityGML 1.0 to 3.0. XML is read as a stream by the standard library, which resolves no external
entities.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.city.footprints import Feature, Projection, make_city
from skyrange.city.reading import Reading
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin

_KINDS: Final = ("Building", "BuildingPart", "BuildingUnit")
_SURFACE_DEPTH: Final = {"MultiSurface": 1, "CompositeSurface": 1, "Solid": 2, "MultiSolid": 3, "CompositeSolid": 3}
"""Levels of lists above a surface, which is a list of rings."""
_OF_PARTS: Final = "without surfaces of their own (the geometry of their parts counts)"
_NO_SURFACES: Final = "without surfaces"
_OF_DEGREES: Final = "of a template, which is in metres, in a system of degrees"

Surface = list[NDArray[np.float64]]
"""Rings (n, 3), the outer one first."""


def read_cityjson(name: str, documents: list[Any], origin: Origin | None) -> tuple[City, Origin]:
    """The city of a CityJSON document, or of the documents of a CityJSONSeq, of which the first has the metadata.

    Raises `InputError` for a document of another kind, a broken geometry and an unknown coordinate system.
    """
    head = documents[0]
    system = (head.get("metadata") or {}).get("referenceSystem") or ""
    if not system:
        expected = "the coordinate system, such as https://www.opengis.net/def/crs/EPSG/0/7415"
        hint = f"Add it: `cjio {name} crs_assign 7415 save city.city.json`."
        raise InputError.one(name, "metadata.referenceSystem", "missing", expected, hint)
    projection = Projection(name, str(system), any_order=True)
    reading = Reading("CityJSON", projection.label)
    features: list[Feature] = []
    for document in documents:
        if not isinstance(document, dict) or not isinstance(document.get("CityObjects"), dict):
            raise InputError.one(name, "CityObjects", type(document).__name__, "an object of city objects by id")
        transform = document.get("transform") or head.get("transform") or {}
        templates = document.get("geometry-templates") or head.get("geometry-templates") or {}
        found, dropped = _objects(name, document, transform, templates)
        if templates and projection.is_geographic:
            kept = [feature for feature in found if not _is_instance(document["CityObjects"][feature.id])]
            dropped[_OF_DEGREES] += len(found) - len(kept)
            found = kept
        reading.features += len(document["CityObjects"])
        reading.dropped.update(dropped)
        features += found
    _choose_order(projection, features, reading, x_is_east=True)
    return make_city(name, features, reading, projection, origin)


def _is_instance(city_object: Mapping[str, Any]) -> bool:
    return any(geometry["type"] == "GeometryInstance" for geometry in city_object.get("geometry") or ())


def _choose_order(projection: Projection, features: list[Feature], reading: Reading, *, x_is_east: bool) -> None:
    """Choose whether latitude or longitude comes first, and note why, for systems in degrees."""
    rings = [ring[:, :2] for feature in features for polygon in feature.polygons for ring in polygon]
    note = projection.choose_order(np.concatenate(rings), x_is_east=x_is_east) if rings else ""
    if note:
        reading.notes.append(note)


def _objects(
    name: str, document: Mapping[str, Any], transform: Mapping[str, Any], templates: Mapping[str, Any]
) -> tuple[list[Feature], Counter[str]]:
    """The buildings of a document, and of other objects how many there are, by the reason why they are none."""
    objects = document["CityObjects"]
    dropped: Counter[str] = Counter()
    try:
        scale, move = (
            np.array(transform.get(key, value), dtype=np.float64).reshape(3)
            for key, value in (("scale", (1, 1, 1)), ("translate", (0, 0, 0)))
        )
        vertices = np.array(document.get("vertices") or [], dtype=np.float64).reshape(-1, 3) * scale + move
    except (TypeError, ValueError) as error:
        raise InputError.one(name, "vertices", str(error), "a list of [x, y, z]") from error
    features = []
    for key, city_object in objects.items():
        kind = str(city_object.get("type"))
        if kind not in _KINDS:
            dropped[f"of type {kind}"] += 1
            continue
        tags = dict(city_object.get("attributes") or {})
        for parent in city_object.get("parents") or ():
            tags = {**(objects.get(parent, {}).get("attributes") or {}), **tags}
        try:
            surfaces = _lowest(city_object.get("geometry") or [], vertices, templates)
        except (IndexError, TypeError, ValueError, KeyError) as error:
            hint = f"Check it: `cjio {name} validate`."
            raise InputError.one(
                name, f"CityObjects.{key}", repr(error), "boundaries of vertex indices", hint
            ) from error
        if not surfaces:
            dropped[_OF_PARTS if city_object.get("children") else _NO_SURFACES] += 1
            continue
        features.append(Feature(f"CityObjects.{key}", key, tags, surfaces))
    return features, dropped


_Shape = tuple[Mapping[str, Any], NDArray[np.float64]]
"""A geometry, and the vertices (n, 3) that its boundaries index."""


def _lowest(
    geometries: list[Mapping[str, Any]], vertices: NDArray[np.float64], templates: Mapping[str, Any]
) -> list[Surface]:
    """The surfaces of the lowest level of detail from 1 on, otherwise of level 0."""
    shapes: list[_Shape] = [
        _placed(geometry, vertices, templates) if geometry["type"] == "GeometryInstance" else (geometry, vertices)
        for geometry in geometries
    ]
    known = [(geometry, points) for geometry, points in shapes if geometry["type"] in _SURFACE_DEPTH]
    ranked = sorted(known, key=lambda shape: (float(shape[0].get("lod", 0)) < 1.0, float(shape[0].get("lod", 0))))
    if not ranked:
        return []
    lod = ranked[0][0].get("lod")
    surfaces: list[Surface] = []
    for geometry, points in ranked:
        if geometry.get("lod") == lod:
            for surface in _surfaces(geometry["boundaries"], _SURFACE_DEPTH[geometry["type"]]):
                rings = [points[np.array(ring, dtype=np.int64)] for ring in surface]
                if rings and all(len(ring) >= 3 for ring in rings):
                    surfaces.append([np.vstack((ring, ring[:1])) for ring in rings])
    return surfaces


def _placed(instance: Mapping[str, Any], vertices: NDArray[np.float64], templates: Mapping[str, Any]) -> _Shape:
    """The template that an instance names, with its vertices where the instance is.

    The specification (CityJSON 2.0, section 4) has instances of things such as trees; some files have buildings too.
    """
    corners = np.array(templates["vertices-templates"], dtype=np.float64).reshape(-1, 3)
    matrix = np.array(instance["transformationMatrix"], dtype=np.float64).reshape(4, 4)
    place = vertices[instance["boundaries"][0]]
    return templates["templates"][instance["template"]], corners @ matrix[:3, :3].T + matrix[:3, 3] + place


def _surfaces(boundaries: Any, depth: int) -> Iterator[Any]:
    for part in boundaries:
        if depth == 1:
            yield part
        else:
            yield from _surfaces(part, depth - 1)


# ---------------------------------------------------------------- CityGML


def read_citygml(path: Path, origin: Origin | None) -> tuple[City, Origin]:
    """The city of a CityGML file.

    Raises `InputError` for XML that is broken or of another kind, and for an unknown coordinate system.
    """
    name = str(path)
    reading = Reading("CityGML")
    features: list[Feature] = []
    system = ""
    try:
        stack: list[ElementTree.Element] = []
        depth = 0  # within a building
        for event, element in ElementTree.iterparse(path, ("start", "end")):  # noqa: S314 (expat bounds entities)
            local = _local(element)
            if event == "start":
                if not stack and local != "CityModel":
                    raise InputError.one(name, "root", "another element", "a CityGML CityModel", _convert_hint(name))
                stack.append(element)
                system = system or element.get("srsName", "")
                depth += local in _KINDS
                continue
            stack.pop()
            system = system or element.get("srsName", "")
            if local in _KINDS:
                depth -= 1
                _add_building(features, element, reading)
                element[:] = [child for child in element if _local(child) in _ATTRIBUTES]
            elif depth == 0:
                if local == "cityObjectMember" and len(element) and _local(element[0]) not in _KINDS:
                    reading.features += 1
                    reading.dropped[f"of type {_local(element[0])}"] += 1
                element.clear()
    except ElementTree.ParseError as error:
        raise InputError.one(name, "file", str(error), "XML", "The file may be cut off.") from error
    except OSError as error:
        raise InputError.one(name, "file", error.strerror or str(error), "a readable CityGML file") from error
    if not system:
        raise InputError.one(
            name, "srsName", "missing", "the coordinate system, such as EPSG:25832", _convert_hint(name)
        )
    projection = Projection(name, system, any_order=True)
    reading.crs = projection.label
    _choose_order(projection, features, reading, x_is_east=False)
    return make_city(name, features, reading, projection, origin)


_ATTRIBUTES: Final = {"measuredHeight": "measuredHeight", "storeysAboveGround": "storeysAboveGround", "name": "name"}


def _add_building(features: list[Feature], element: ElementTree.Element, reading: Reading) -> None:
    reading.features += 1
    tags = {_ATTRIBUTES[_local(child)]: child.text for child in element if _local(child) in _ATTRIBUTES}
    for child in element.iter():
        if _local(child) == "Height":  # CityGML 3.0: con:height/con:Height/con:value
            value = next((part.text for part in child if _local(part) == "value"), None)
            tags.setdefault("measuredHeight", value)
    by_lod: dict[str, list[Surface]] = {}
    _collect(element, "", by_lod)
    levels = sorted(by_lod, key=lambda lod: (lod < "1", lod))
    identity = next((value for key, value in element.attrib.items() if key.endswith("id")), "")
    if not levels:
        has_parts = any(_local(part) in _KINDS for part in element.iter() if part is not element)
        reading.dropped[_OF_PARTS if has_parts else _NO_SURFACES] += 1
        return
    features.append(Feature(f"building {identity or len(features)}", identity, tags, by_lod[levels[0]]))


def _collect(element: ElementTree.Element, lod: str, by_lod: dict[str, list[Surface]]) -> None:
    """Collect the polygons below an element, by their level of detail."""
    for child in element:
        local = _local(child)
        level = local[3] if local.startswith("lod") and local[3:4].isdigit() else lod
        if local == "Polygon":
            rings = [_ring(ring) for ring in child.iter() if _local(ring) == "LinearRing"]
            if rings and all(len(ring) >= 4 for ring in rings):
                by_lod.setdefault(level or "2", []).append(rings)
        else:
            _collect(child, level, by_lod)


def _ring(ring: ElementTree.Element) -> NDArray[np.float64]:
    """The vertices of a LinearRing (posList or pos), (n, 3); none if they are no numbers."""
    text = " ".join(part.text or "" for part in ring if _local(part) in ("posList", "pos"))
    try:
        numbers = np.array(text.split(), dtype=np.float64)
    except ValueError:
        return np.empty((0, 3))
    return numbers.reshape(-1, 3) if len(numbers) % 3 == 0 else np.empty((0, 3))


def _local(element: ElementTree.Element) -> str:
    """The name of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def _convert_hint(name: str) -> str:
    return f"Convert it: `ogr2ogr -f GeoJSON -t_srs EPSG:4326 city.geojson {name}`."
