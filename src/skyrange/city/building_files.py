"""Files of buildings in the formats in which cities and maps publish them, chosen by the file's name.

| name | format | reader |
|---|---|---|
| .geojson, .json | GeoJSON, CityJSON | `city.geojson`, `city.solids` |
| .geojsonl, .geojsons, .geojsonseq, .ndjson, .jsonl | GeoJSON or CityJSON, one feature a line | the same |
| .osm, .pbf, .shp, .zip, .gpkg, .fgb | see `city.gdal_files.DRIVERS` | GDAL through pyogrio |
| .gml, .citygml, .xml | CityGML | `city.solids` |
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

from skyrange.city.city import City
from skyrange.city.geojson import read_collection, read_json, read_json_lines
from skyrange.core.errors import InputError
from skyrange.core.files import open_input
from skyrange.core.geodesy import Origin

_JSON: Final = (".geojson", ".json")
_LINES: Final = (".geojsonl", ".geojsons", ".geojsonseq", ".ndjson", ".jsonl")
_CITYGML: Final = (".gml", ".citygml", ".xml")
_GDAL: Final = (".osm", ".pbf", ".shp", ".zip", ".gpkg", ".fgb")
_READ: Final = ", ".join((*_JSON, *_LINES, *_GDAL, *_CITYGML))
_COMMANDS: Final = {
    ".gz": "gunzip --keep {name}", ".bz2": "bunzip2 --keep {name}", ".xz": "unxz --keep {name}",
    ".7z": "7z x {name}", ".tar": "tar -xf {name}", ".tgz": "tar -xf {name}",
    ".ifc": "IfcConvert --use-world-coordinates {name} city.obj",
}  # fmt: skip
_OGR: Final = "ogr2ogr -f GeoJSON -t_srs EPSG:4326 city.geojson {name}"
"""Converts what GDAL reads, such as .parquet, .gdb, .dxf, .kml and .tab."""


def load_buildings(path: Path | str, origin: Origin | None = None) -> tuple[City, Origin]:
    """Read the city in a file, in metres from `origin`; by default from the centre of the buildings' bounding box.

    `City.reading` says what was kept and dropped. Raises `InputError` for a file that cannot be read; the error names
    a command that converts it, if there is one.
    """
    path, name = Path(path), str(path)
    suffix = path.suffix.lower()
    if suffix in _JSON:
        document = read_json(name, path)
        if isinstance(document, dict) and document.get("type") == "CityJSON":
            return _cityjson(name, [document], origin)
        return read_collection(name, document, origin)
    if suffix in _LINES:
        rows = read_json_lines(name, path)
        if rows and isinstance(rows[0], dict) and rows[0].get("type") == "CityJSON":
            return _cityjson(name, rows, origin)
        return read_collection(name, {"type": "FeatureCollection", "features": rows}, origin, "GeoJSONSeq")
    with open_input(path, name, "file", expected="a file of buildings"):
        pass  # no pipe, no device
    if suffix in _GDAL:
        from skyrange.city.gdal_files import read_gdal

        return read_gdal(path, origin)
    if suffix in _CITYGML:
        from skyrange.city.solids import read_citygml

        return read_citygml(path, origin)
    command = _COMMANDS.get(suffix, _OGR).format(name=name)
    raise InputError.one(name, "format", suffix or "no extension", f"one of {_READ}", f"Convert it: `{command}`.")


def _cityjson(name: str, documents: list[Any], origin: Origin | None) -> tuple[City, Origin]:
    from skyrange.city.solids import read_cityjson

    return read_cityjson(name, documents, origin)


def files_of(path: Path) -> list[Path]:
    """The files that a file of buildings consists of: itself, and for a Shapefile those beside it."""
    if path.suffix.lower() != ".shp":
        return [path]
    beside = (path.with_suffix(suffix) for suffix in (".shx", ".dbf", ".prj", ".cpg"))
    return [path, *(file for file in beside if os.path.exists(file))]
