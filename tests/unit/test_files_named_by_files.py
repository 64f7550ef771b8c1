"""What a received file names is not opened: no request and no other file, whatever library reads it."""

from __future__ import annotations

import json
import re
import socket
import sqlite3
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import shapely

import skyrange
from skyrange.city.building_files import load_buildings
from skyrange.core.errors import InputError

pyogrio = pytest.importorskip("pyogrio", reason="pyogrio is not installed (skyrange[city])")
pyproj = pytest.importorskip("pyproj", reason="pyproj is not installed (skyrange[city])")

OPENERS = {
    "pyogrio": "city/gdal_files.py",
    "pyproj": "city/footprints.py",
    "xml.etree": "city/solids.py figures/svg.py vehicle/gazebo/sdf_elements.py vehicle/gazebo/world_file.py",
    "fsspec": "study/execution/storage.py",
    "urllib.request": "install/download.py",
    "pandas": "record/read/run.py",
    "polars": "record/read/run.py",
}
"""Libraries that open what a file may name, and the modules that call them: one that reads needs inputs in `HOSTILE`.

Figures and worlds of Gazebo are written; fsspec and urllib get URLs from the command line and from the package; pandas
and polars are given tables.
"""
UNUSED = (
    "pyarrow.dataset", "pyarrow.fs", "lxml", "duckdb", "pickle", "requests", "sqlite3", "fiona",
    "osgeo", "rasterio", "xml.dom", "xml.sax.expatreader",
)  # fmt: skip
IMPORT = re.compile(r"^[ \t]*(?:from|import) ([\w.]+)(?: import (?!Element$)(.*))?$", re.MULTILINE)

SUFFIXES = (".geojson", ".osm", ".pbf", ".shp", ".zip", ".gpkg", ".fgb", ".gml")
"""One of each reader and driver."""
RING = [[8.545, 47.397], [8.5454, 47.397], [8.5454, 47.3973], [8.545, 47.3973], [8.545, 47.397]]


def geojson(crs: str = "") -> dict[str, object]:
    shape = {"type": "Polygon", "coordinates": [RING]}
    row = {"type": "Feature", "properties": {"building": "yes"}, "geometry": shape}
    named = {"crs": {"type": "name", "properties": {"name": crs}}} if crs else {}
    return {"type": "FeatureCollection", **named, "features": [row]}


def virtual(source: str) -> str:
    layer = f'<OGRVRTLayer name="real"><SrcDataSource>{source}</SrcDataSource></OGRVRTLayer>'
    return f"<OGRVRTDataSource>{layer}</OGRVRTDataSource>"


def zipped(source: str, path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.vrt", virtual(source))


def view(source: str, path: Path) -> None:
    """A GeoPackage whose layer is a view that geocodes."""
    whole = path.with_name("whole.gpkg")
    whole.unlink(missing_ok=True)
    pyogrio.raw.write(
        whole, geometry=shapely.to_wkb(np.array([shapely.Polygon(RING)])), driver="GPKG", crs="EPSG:4326", layer="real",
        geometry_type="Polygon", fields=["building"], field_data=[np.array(["yes"], dtype=object)],
    )  # fmt: skip
    with sqlite3.connect(whole) as base:
        call = f"ogr_geocode('x', 'geometry', 'QUERY_TEMPLATE={source}?q=%s')"
        base.execute(f"CREATE VIEW buildings AS SELECT fid, geom, {call} AS building FROM real")
        base.execute("INSERT INTO gpkg_contents (table_name, data_type, srs_id) VALUES ('buildings', 'features', 4326)")
        base.execute("INSERT INTO gpkg_geometry_columns VALUES ('buildings', 'geom', 'POLYGON', 4326, 0, 0)")
    base.close()
    path.write_bytes(whole.read_bytes())


def with_crs(crs: str) -> Callable[[str, Path], None]:
    return lambda source, path: write(path, json.dumps(geojson(crs.replace("SOURCE", source))))


def write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


BASE = 'GEOGCS["x",DATUM["x",SPHEROID["x",6378137,298.3]{}],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]{}]'
HOSTILE: dict[str, Callable[[str, Path], None]] = {
    "virtual file": lambda source, path: write(path, virtual(source)),
    "virtual file beside <osm>": lambda source, path: write(path, f'<osm version="0.6"/>{virtual(source)}'),
    "virtual file in a zip": zipped,
    "pipeline": lambda source, path: write(
        path, json.dumps({"type": "gdal_streamed_alg", "command_line": f"gdal vector pipeline ! read {source}"})
    ),
    "WFS": lambda source, path: write(path, f"<OGRWFSDataSource><URL>{source}</URL></OGRWFSDataSource>"),
    "view of a database": view,
    "entity": lambda source, path: write(
        path,
        f'<!DOCTYPE CityModel SYSTEM "{source}" [<!ENTITY e SYSTEM "{source}">]>'
        f'<CityModel xmlns="http://www.opengis.net/citygml/2.0"><name>&e;</name></CityModel>',
    ),
    "CityJSON": lambda source, path: write(
        path, json.dumps({"type": "CityJSON", "metadata": {"referenceSystem": source}, "CityObjects": {}})
    ),
    "grid of PROJ": with_crs("+proj=longlat +ellps=bessel +nadgrids=SOURCE +type=crs"),
    "file of PROJ": with_crs("+init=SOURCE:name"),
    "grid in WKT": with_crs(BASE.format("", ',EXTENSION["PROJ4","+proj=longlat +nadgrids=SOURCE"]')),
    "grid in PROJJSON": with_crs('{"type": "BoundCRS", "value": "SOURCE"}'),
}
"""Writers of files that name `source`."""


LISTENER = """
import socket, sys
server = socket.socket(fileno=int(sys.argv[1]))
while True:
    connection, _ = server.accept()
    print(flush=True)
    connection.close()
"""


@pytest.fixture
def requests() -> Iterator[tuple[str, Callable[[], int]]]:
    """A URL, and how many connected there; a process listens, because GDAL and PROJ hold the interpreter's lock."""
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        subprocess.Popen(
            [sys.executable, "-ISc", LISTENER, str(server.fileno())], pass_fds=[server.fileno()], stdout=subprocess.PIPE
        ) as listener,
    ):

        def count() -> int:
            with socket.create_connection(server.getsockname()) as own:
                own.recv(1)
            listener.kill()
            assert listener.stdout is not None
            return len(listener.stdout.readlines()) - 1

        pyproj.network.set_network_enabled(active=True)  # as with PROJ_NETWORK=ON
        try:
            yield f"http://127.0.0.1:{server.getsockname()[1]}/real.geojson", count
        finally:
            pyproj.network.set_network_enabled(active=False)
            listener.kill()


@pytest.mark.parametrize("kind", HOSTILE)
@pytest.mark.rotating
def test_no_file_makes_a_request_or_reads_another_file(
    kind: str, tmp_path: Path, requests: tuple[str, Callable[[], int]]
) -> None:
    url, count_requests = requests
    write(tmp_path / "other.geojson", json.dumps(geojson()))
    read = []
    for source in (url, f"/vsicurl/{url}", str(tmp_path / "other.geojson")):
        for suffix in SUFFIXES:
            path = tmp_path / f"given{suffix}"
            HOSTILE[kind](source, path)
            with suppress(InputError):
                load_buildings(path)
                read.append((source, suffix))
            path.unlink()
    assert read == []
    assert count_requests() == 0


def test_the_drivers_of_gdal_are_as_before() -> None:
    """Also their order, which decides how a file is taken that several of them know."""
    before = list(pyogrio.list_drivers())
    with pytest.raises(InputError):
        load_buildings(Path(__file__).with_name("none.gpkg"))
    assert list(pyogrio.list_drivers()) == before
    assert len(before) > 20


def test_web_mercator_names_no_grid(tmp_path: Path) -> None:
    """`nadgrids=@null` in its text is no file."""
    mercator = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:3857", always_xy=True)
    shape = shapely.transform(shapely.Polygon(RING), lambda xy: np.column_stack(mercator.transform(*xy.T)))
    text = pyproj.CRS("EPSG:3857").to_wkt("WKT1_GDAL")
    assert "nadgrids=@null" in text
    document = geojson(text)
    document["features"][0]["geometry"]["coordinates"] = [shapely.get_coordinates(shape).tolist()]  # type: ignore[index]
    path = tmp_path / "c.geojson"
    write(path, json.dumps(document))
    _, origin = load_buildings(path)
    assert (origin.lat_deg, origin.lon_deg) == pytest.approx((47.39715, 8.5452), abs=1e-5)


def test_every_library_that_opens_what_a_file_names_is_known() -> None:
    root = Path(skyrange.__file__).parent
    found: dict[str, set[str]] = {}
    for path in root.rglob("*.py"):
        for start, names in IMPORT.findall(path.read_text(encoding="utf-8")):
            for library in (*OPENERS, *UNUSED):
                parent, _, name = library.rpartition(".")
                if f"{start}.".startswith(f"{library}.") or (start == parent and name in names.split()):
                    found.setdefault(library, set()).add(str(path.relative_to(root)))
    assert found == {library: set(users.split()) for library, users in OPENERS.items()}
