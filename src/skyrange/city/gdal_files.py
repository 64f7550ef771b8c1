"""Building files that GDAL reads: OpenStreetMap XML and PBF, Shapefile, GeoPackage and FlatGeobuf, through pyogrio.

GDAL tells formats by their contents, and some formats name other files and URLs, which it opens as well. So only the
driver of the file's name is registered while a file is open; none of `DRIVERS` opens anything that a file names.
"""

from __future__ import annotations

import ctypes
import importlib
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import shapely

from skyrange.city.building_heights import BASE_KEYS, KEYS
from skyrange.city.city import City
from skyrange.city.footprints import BUILDING_KEYS, Feature, Projection, choose_buildings, make_city
from skyrange.city.reading import Reading
from skyrange.core.errors import InputError
from skyrange.core.extras import describe_install
from skyrange.core.geodesy import Origin

DRIVERS: Final[Mapping[str, str]] = {
    ".osm": "OSM", ".pbf": "OSM", ".shp": "ESRI Shapefile", ".zip": "ESRI Shapefile", ".gpkg": "GPKG",
    ".fgb": "FlatGeobuf",
}  # fmt: skip
"""GDAL's driver by the end of a file's name; no other driver may open it."""

_IDS: Final = ("osm_id", "osm_way_id", "id", "gml_id", "fid", "identifier")
_OSM_TAGS: Final = ("building", "building:part", "building:levels", "building:height", "building:min_level", "height")
_OSM_CONF: Final = """\
closed_ways_are_polygons=building,building:part
attribute_name_laundering=no
report_all_ways=no
[points]
attributes={tags}
[lines]
osm_id=yes
attributes={tags}
[multipolygons]
osm_id=yes
attributes={tags}
[multilinestrings]
attributes={tags}
[other_relations]
attributes={tags}
"""
"""Settings of GDAL's OSM driver (osmconf.ini): which tags become attributes, and that parts of buildings are areas."""
_WORDS: Final = ("build", "footprint", "gebaeude", "gebäude", "bati", "bâti", "edific", "pand", "roof", "house")
"""What names of layers with buildings contain."""
_TOPO: Final = "Polygon"


def read_gdal(path: Path, origin: Origin | None) -> tuple[City, Origin]:
    """The city of a file of one of the formats in `DRIVERS`; raises `InputError` if it cannot be read.

    Of several layers with polygons, the one is read whose name says that it has buildings.
    """
    name = str(path)
    try:
        import pyogrio
        from pyogrio.errors import DataLayerError, DataSourceError, FeatureError, FieldError, GeometryError
    except ImportError as error:
        expected = "pyogrio, which reads it"
        hint = f"{describe_install('city')}. Or convert it: `ogr2ogr -f GeoJSON -t_srs EPSG:4326 city.geojson {name}`."
        raise InputError.one(name, "format", path.suffix, expected, hint) from error
    driver = DRIVERS[path.suffix.lower()]
    try:
        with tempfile.TemporaryDirectory(prefix="skyrange-osm-") as folder, _only_driver(driver):
            return _read(pyogrio, path, driver, Path(folder), origin)
    except (
        DataLayerError, DataSourceError, FeatureError, FieldError, GeometryError, shapely.errors.GEOSException,
    ) as error:  # fmt: skip
        value = str(error).splitlines()[0].partition("; It might help")[0]
        only = f"-if '{driver}'"  # these programs open what a file names as well
        repair = f"ogr2ogr {only} -f GeoJSON -makevalid city.geojson {name}"
        hint = f"Check it: `ogrinfo {only} -al -so {name}`; repair it: `{repair}`."
        expected = f"a {path.suffix} file ({driver})"
        raise InputError.one(name, "file", value, expected, hint) from error


@contextmanager
def _only_driver(name: str) -> Iterator[None]:
    """Deregister all of GDAL's drivers but one; register them again at the end, in their order.

    pyogrio cannot name the drivers that may open a file, so this calls GDAL's C interface, which the extension modules
    of pyogrio link. The drivers are those of the process: one thread at a time reads such files.
    """
    gdal = ctypes.CDLL(importlib.import_module("pyogrio._ogr").__file__)
    gdal.GDALGetDriver.restype = ctypes.c_void_p
    gdal.GDALGetDescription.restype = ctypes.c_char_p
    for function in (gdal.GDALGetDescription, gdal.GDALRegisterDriver, gdal.GDALDeregisterDriver):
        function.argtypes = [ctypes.c_void_p]
    drivers = [gdal.GDALGetDriver(index) for index in range(gdal.GDALGetDriverCount())]
    kept = [driver for driver in drivers if gdal.GDALGetDescription(driver) == name.encode()]
    try:
        for driver in drivers:
            if driver not in kept:
                gdal.GDALDeregisterDriver(driver)
        yield
    finally:
        for driver in kept:
            gdal.GDALDeregisterDriver(driver)
        for driver in drivers:
            gdal.GDALRegisterDriver(driver)


def _read(pyogrio: Any, path: Path, driver: str, folder: Path, origin: Origin | None) -> tuple[City, Origin]:
    name = str(path)
    options: dict[str, Any] = {}
    if driver == "OSM":
        conf = folder / "osmconf.ini"
        conf.write_text(_OSM_CONF.format(tags=",".join((*_OSM_TAGS, *BASE_KEYS, "name"))), encoding="utf-8")
        options = {"CONFIG_FILE": str(conf)}
    layers = [(str(layer), str(kind)) for layer, kind in pyogrio.list_layers(path)]
    layer = _layer(name, layers)
    info = pyogrio.read_info(path, layer=layer)
    fields = [str(field) for field in info["fields"]]
    if driver != "OSM":
        wanted = {*KEYS, *BUILDING_KEYS, *_IDS, "name"}
        options = {"columns": [field for field in fields if field.lower() in wanted or _is_other(field)]}
    meta, _, geometry, values = pyogrio.raw.read(path, layer=layer, **options)
    tags = _tags([str(field) for field in meta["fields"]], values, len(geometry))
    shapes = shapely.from_wkb(geometry)
    projection = _projection(name, path, meta["crs"], shapes)
    reading = Reading(driver, projection.label, len(shapes))
    if driver == "OSM":
        _count_others(pyogrio, path, options, reading)
    elif len(layers) > 1:
        reading.notes.append(f"read of {len(layers)} layers: {layer}")
    return make_city(name, _features(tags, shapes, reading), reading, projection, origin)


def _is_other(field: str) -> bool:
    return field.lower() in ("highway", "landuse", "natural", "leisure", "waterway", "railway", "boundary", "amenity")


def _layer(name: str, layers: Sequence[tuple[str, str]]) -> str:
    """The layer with buildings."""
    areas = [layer for layer, kind in layers if _TOPO in kind or kind in ("Unknown", "GeometryCollection", "None")]
    areas = [layer for layer, kind in layers if _TOPO in kind] or areas
    named = [layer for layer in areas if any(word in layer.lower() for word in _WORDS)]
    for candidates in (areas, named):
        if len(candidates) == 1:
            return candidates[0]
    value = ", ".join(areas or (f"{layer} ({kind})" for layer, kind in layers))
    if not areas:
        raise InputError.one(name, "layers", value, "a layer with polygons")
    hint = f"Choose one: `ogr2ogr -f FlatGeobuf buildings.fgb {name} LAYER`."
    raise InputError.one(name, "layers", value, "one layer with buildings", hint)


def _tags(fields: Sequence[str], values: Sequence[Any], count: int) -> list[dict[str, Any]]:
    """The attributes of each feature, without those that it lacks."""
    tags: list[dict[str, Any]] = [{} for _ in range(count)]
    for field, column in zip(fields, values, strict=True):
        for feature_tags, value in zip(tags, column.tolist(), strict=True):
            if value is not None and value == value:  # NaN is how GDAL's numbers are null
                feature_tags[field] = value
    return tags


def _projection(name: str, path: Path, crs: str | None, shapes: Any) -> Projection:
    if crs:
        return Projection(name, crs)
    west, south, east, north = shapely.total_bounds(shapes).tolist()
    if max(abs(west), abs(east)) <= 180.0 and max(abs(south), abs(north)) <= 90.0:
        projection = Projection(name, "")
        projection.label = "no coordinate system stated, read as WGS 84 degrees"
        return projection
    hint = f"State it: `ogr2ogr -f FlatGeobuf -a_srs EPSG:… city.fgb {path}`."
    raise InputError.one(name, "coordinate system", "missing", "a stated coordinate system, or degrees", hint)


def _features(tags: Sequence[Mapping[str, Any]], shapes: Any, reading: Reading) -> list[Feature]:
    polygonal = []
    for index, shape in enumerate(shapes):
        if shape is None or shape.is_empty:
            reading.dropped["without geometry"] += 1
        elif shape.geom_type not in ("Polygon", "MultiPolygon"):
            reading.dropped[f"of type {shape.geom_type}"] += 1
        else:
            polygonal.append(index)
    features = []
    reasons = choose_buildings([tags[index] for index in polygonal], reading)
    for index, reason in zip(polygonal, reasons, strict=True):
        if reason:
            reading.dropped[reason] += 1
            continue
        polygons = [
            [shapely.get_coordinates(ring, include_z=shape_has_z(ring)) for ring in (part.exterior, *part.interiors)]
            for part in shapely.get_parts(shapes[index])
        ]
        features.append(Feature(f"features[{index}]", _id(tags[index]), tags[index], polygons))
    return features


def shape_has_z(shape: Any) -> bool:
    """Whether a geometry has heights."""
    return bool(shapely.has_z(shape))


def _id(tags: Mapping[str, Any]) -> str:
    if tags.get("osm_way_id"):
        return f"way/{tags['osm_way_id']}"
    if tags.get("osm_id"):
        return f"relation/{tags['osm_id']}"
    return next((str(tags[key]) for key in tags if key.lower() in _IDS), "")


def _count_others(pyogrio: Any, path: Path, options: Mapping[str, Any], reading: Reading) -> None:
    """Count what has a building tag in an OpenStreetMap file and is no area, such as a way that is not closed."""
    counts: Counter[str] = Counter()
    for layer, kind in (
        ("points", "node"), ("lines", "way that is not closed"), ("multilinestrings", "relation of open ways"),
        ("other_relations", "relation of another type"),
    ):  # fmt: skip
        meta, _, geometry, values = pyogrio.raw.read(path, layer=layer, **options)
        tags = _tags([str(field) for field in meta["fields"]], values, len(geometry))
        counts[kind] = sum(
            1 for feature_tags in tags if any(feature_tags.get(key, "no") != "no" for key in BUILDING_KEYS)
        )
    for kind, count in counts.items():
        if count:
            reading.features += count
            reading.dropped[f"with a building tag on a {kind}"] += count
