"""Buildings as cities publish them: every format becomes the same city, and nothing is dropped in silence."""

from __future__ import annotations

import importlib
import json
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from skyrange.city.building_files import files_of, load_buildings
from skyrange.city.reading import describe_reading
from skyrange.core.errors import InputError

pyogrio = pytest.importorskip("pyogrio", reason="pyogrio is not installed (skyrange[city])")
pytest.importorskip("pyproj", reason="pyproj is not installed (skyrange[city])")

UTM32 = "EPSG:25832"
SQUARE = [(691000, 5334000), (691030, 5334000), (691030, 5334020), (691000, 5334020), (691000, 5334000)]
HOLE = [(691010, 5334005), (691010, 5334010), (691020, 5334010), (691020, 5334005), (691010, 5334005)]


def moved(ring: list[tuple[int, int]], east: int) -> list[tuple[int, int]]:
    return [(x + east, y) for x, y in ring]


SHAPES = [
    shapely.Polygon(SQUARE, [HOLE]),
    shapely.MultiPolygon([shapely.Polygon(moved(SQUARE, 50)), shapely.Polygon(moved(SQUARE, 100))]),
    shapely.Polygon(moved(SQUARE, 150)),
    shapely.Polygon(moved(SQUARE, 200)),
]
TAGS: dict[str, list[Any]] = {
    "building": ["yes", "house", "yes", None],
    "height": ["12.5", None, None, "99"],
    "building:levels": [None, "4", None, None],
    "name": ["Hall", None, None, None],
}


def write_gdal(path: Path, driver: str, names: dict[str, str], crs: str | None = UTM32, **options: Any) -> Path:
    """`names` gives the fields' names in that format."""
    pyogrio.raw.write(
        path, geometry=shapely.to_wkb(np.array(SHAPES)), driver=driver, crs=crs, geometry_type="MultiPolygon",
        promote_to_multi=True, fields=[names.get(name, name) for name in TAGS],
        field_data=[np.array(column, dtype=object) for column in TAGS.values()], **options,
    )  # fmt: skip
    return path


def degrees(shape: Any) -> Any:
    from pyproj import Transformer

    there = Transformer.from_crs(UTM32, "EPSG:4326", always_xy=True)
    return shapely.transform(shape, lambda xy: np.column_stack(there.transform(xy[:, 0], xy[:, 1])))


def geojson_rows(change: Any = degrees) -> list[dict[str, Any]]:
    rows = []
    for number, shape in enumerate(SHAPES):
        tags = {name: column[number] for name, column in TAGS.items() if column[number] is not None}
        geometry = json.loads(shapely.to_geojson(change(shape)))
        rows.append({"type": "Feature", "properties": tags, "geometry": geometry})
    return rows


def make_file(kind: str, folder: Path) -> Path:
    if kind == "GeoJSON":
        path = folder / "c.geojson"
        path.write_text(json.dumps({"type": "FeatureCollection", "features": geojson_rows()}), encoding="utf-8")
    elif kind == "GeoJSON of 2008":
        crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
        rows = geojson_rows(lambda shape: shape)
        path = folder / "c.json"
        path.write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": rows}), encoding="utf-8")
    elif kind == "GeoJSONSeq":
        path = folder / "c.geojsonl"
        path.write_text("".join(f"\x1e{json.dumps(row)}\n" for row in geojson_rows()), encoding="utf-8")
    elif kind == "FlatGeobuf":
        path = write_gdal(folder / "c.fgb", "FlatGeobuf", {})
    elif kind == "GPKG":
        path = write_gdal(folder / "c.gpkg", "GPKG", {"building:levels": "num_floors"}, layer="batiments")
        pyogrio.raw.write(
            path, geometry=shapely.to_wkb(np.array(SHAPES[:1])), driver="GPKG", crs=UTM32, geometry_type="Polygon",
            fields=["landuse"], field_data=[np.array(["grass"], dtype=object)], layer="parcels", append=True,
        )  # fmt: skip
    else:
        path = write_gdal(folder / "c.shp", "ESRI Shapefile", {"building:levels": "building_l"})
        if kind == "zipped Shapefile":
            with zipfile.ZipFile(folder / "c.zip", "w") as archive:
                for file in files_of(path):
                    archive.write(file, file.name)
            path = folder / "c.zip"
    return path


@pytest.mark.parametrize(
    "kind", ["GeoJSON", "GeoJSON of 2008", "GeoJSONSeq", "FlatGeobuf", "GPKG", "Shapefile", "zipped Shapefile"]
)
def test_every_format_becomes_the_same_city(kind: str, tmp_path: Path) -> None:
    city, origin = load_buildings(make_file(kind, tmp_path))
    assert (origin.lat_deg, origin.lon_deg) == pytest.approx((48.1307, 11.5686), abs=1e-3)
    buildings = sorted(city.buildings, key=lambda building: building.shape.bounds)  # FlatGeobuf sorts its features
    assert [(building.height_m, building.name) for building in buildings] == [(12.5, "Hall"), (12, ""), (9, "")]
    areas = [building.shape.area for building in buildings]
    assert areas == pytest.approx([550.0, 1200.0, 600.0], rel=2e-3)  # UTM is 0.06 % smaller than the ground there
    assert [building.shape.geom_type for building in buildings][1] == "MultiPolygon"
    told = city.reading
    assert told is not None
    assert (told.features, told.kept, told.dropped) == (4, 3, {"without a building tag": 1})
    assert told.heights == {"measured": 1, "derived": 1, "defaulted": 1}
    assert ("WGS 84 degrees" if kind in ("GeoJSON", "GeoJSONSeq") else "EPSG:25832") in told.crs
    lines = describe_reading(told.to_dict())
    assert "3 buildings of 4 features" in lines[0]
    assert "1 dropped: 1 without a building tag" in lines[0]
    assert "1 measured, 1 derived, 1 defaulted" in lines[1]


OSM = """<?xml version="1.0"?><osm version="0.6">
<node id="1" lat="47.3970" lon="8.5450"/><node id="2" lat="47.3970" lon="8.5454"/>
<node id="3" lat="47.3973" lon="8.5454"/><node id="4" lat="47.3973" lon="8.5450"/>
<node id="5" lat="47.3971" lon="8.5451"/><node id="6" lat="47.3971" lon="8.5453"/>
<node id="7" lat="47.3972" lon="8.5453"/><node id="8" lat="47.3972" lon="8.5451"/>
<node id="9" lat="47.3990" lon="8.5451"><tag k="building" v="yes"/></node>
<way id="10"><nd ref="1"/><nd ref="2"/><nd ref="3"/><nd ref="4"/><nd ref="1"/></way>
<way id="11"><nd ref="5"/><nd ref="6"/><nd ref="7"/><nd ref="8"/><nd ref="5"/></way>
<way id="12"><nd ref="5"/><nd ref="6"/><nd ref="7"/><nd ref="8"/><nd ref="5"/>
 <tag k="building:part" v="yes"/><tag k="height" v="40 m"/><tag k="min_height" v="5"/></way>
<way id="13"><nd ref="1"/><nd ref="2"/><nd ref="3"/><tag k="building" v="yes"/></way>
<way id="14"><nd ref="1"/><nd ref="2"/><nd ref="3"/><nd ref="1"/><tag k="landuse" v="grass"/></way>
<relation id="20"><member type="way" ref="10" role="outer"/><member type="way" ref="11" role="inner"/>
 <tag k="type" v="multipolygon"/><tag k="building" v="yes"/><tag k="building:levels" v="5"/></relation>
</osm>"""


def test_openstreetmap_with_relations_parts_and_what_is_no_area(tmp_path: Path) -> None:
    path = tmp_path / "c.osm"
    path.write_text(OSM, encoding="utf-8")
    city, _ = load_buildings(path)
    found = {building.id: (building.height_m, building.base_m) for building in city.buildings}
    assert found == {"relation/20": (15.0, 0.0), "way/12": (40.0, 5.0)}
    assert city.height_at(0.0, 0.0) == 40.0
    assert city.reading is not None
    assert city.reading.features == 4
    assert city.reading.dropped == {
        "with a building tag on a node": 1, "with a building tag on a way that is not closed": 1,
    }  # fmt: skip
    assert [file.name for file in tmp_path.iterdir()] == ["c.osm"]


def box(east: float, low: float, high: float) -> list[list[list[float]]]:
    """The six faces of a box, closed rings."""
    x0, x1, y0, y1 = 691000 + east, 691030 + east, 5334000, 5334020
    ground = [[x0, y0, low], [x0, y1, low], [x1, y1, low], [x1, y0, low]]
    roof = [[x0, y0, high], [x1, y0, high], [x1, y1, high], [x0, y1, high]]
    faces = [ground, roof]
    for a, b in (((x0, y0), (x1, y0)), ((x1, y0), (x1, y1)), ((x1, y1), (x0, y1)), ((x0, y1), (x0, y0))):
        faces.append([[*a, low], [*b, low], [*b, high], [*a, high]])
    return [[*face, face[0]] for face in faces]


def citygml(crs: str = "urn:ogc:def:crs,crs:EPSG::25832,crs:EPSG::7837") -> str:
    def solid(faces: list[list[list[float]]]) -> str:
        rings = "".join(
            "<gml:surfaceMember><gml:Polygon><gml:exterior><gml:LinearRing><gml:posList>"
            + " ".join(f"{value}" for point in face for value in point)
            + "</gml:posList></gml:LinearRing></gml:exterior></gml:Polygon></gml:surfaceMember>"
            for face in faces
        )
        return (
            "<bldg:lod1Solid><gml:Solid><gml:exterior><gml:CompositeSurface>"
            f"{rings}</gml:CompositeSurface></gml:exterior></gml:Solid></bldg:lod1Solid>"
        )

    return f"""<?xml version="1.0"?><core:CityModel xmlns:core="http://www.opengis.net/citygml/2.0"
 xmlns:bldg="http://www.opengis.net/citygml/building/2.0" xmlns:gml="http://www.opengis.net/gml">
<gml:boundedBy><gml:Envelope srsName="{crs}" srsDimension="3"/></gml:boundedBy>
<core:cityObjectMember><bldg:Building gml:id="B1"><gml:name>Hall</gml:name>
 <bldg:measuredHeight uom="m">12.5</bldg:measuredHeight>{solid(box(0, 500, 512))}</bldg:Building>
 </core:cityObjectMember>
<core:cityObjectMember><bldg:Building gml:id="B2"><bldg:consistsOfBuildingPart><bldg:BuildingPart gml:id="B2a">
 {solid(box(50, 501, 521))}</bldg:BuildingPart></bldg:consistsOfBuildingPart></bldg:Building></core:cityObjectMember>
<core:cityObjectMember><bldg:Road/></core:cityObjectMember>
</core:CityModel>"""


def test_citygml(tmp_path: Path) -> None:
    path = tmp_path / "lod1.gml"
    path.write_text(citygml(), encoding="utf-8")
    city, origin = load_buildings(path)
    assert (origin.lat_deg, origin.lon_deg) == pytest.approx((48.1306, 11.5676), abs=1e-3)
    assert [(b.id, b.name, b.height_m, round(b.shape.area)) for b in city.buildings] == [
        ("B1", "Hall", 12.5, 600), ("B2a", "", 20.0, 600),
    ]  # fmt: skip
    assert city.reading is not None
    assert city.reading.features == 4
    assert city.reading.dropped == {
        "of type Road": 1, "without surfaces of their own (the geometry of their parts counts)": 1,
    }  # fmt: skip
    assert city.reading.heights == {"measured": 1, "derived": 1}
    assert [file.name for file in tmp_path.iterdir()] == ["lod1.gml"]  # GDAL would leave a .gfs beside it


def test_citygml_in_degrees_is_latitude_first(tmp_path: Path) -> None:
    path = tmp_path / "plateau.gml"
    text = citygml("http://www.opengis.net/def/crs/EPSG/0/6697")
    for metres, degree in (("5334000", "139.7500"), ("5334020", "139.7502")):
        text = text.replace(metres, degree)
    for east in (691000, 691030, 691050, 691080):
        text = text.replace(str(east), f"{35.68 + (east - 691000) * 1e-5:.5f}")
    path.write_text(text, encoding="utf-8")
    _, origin = load_buildings(path)
    assert (origin.lat_deg, origin.lon_deg) == pytest.approx((35.6804, 139.7501), abs=1e-4)


def cityjson() -> dict[str, Any]:
    vertices: list[list[int]] = []
    objects: dict[str, Any] = {}
    for key, east, tags in (
        ("B1", 0, {"measuredHeight": 12.5}),
        ("B2", 50, {"storeysAboveGround": 2}),
        ("B3", 100, {}),
    ):
        faces = []
        for face in box(east, 500, 520 if key == "B3" else 500):
            faces.append([[len(vertices) + number for number in range(4)]])
            vertices += [
                [round((x - 691000) * 100), round((y - 5334000) * 100), round(z * 100)] for x, y, z in face[:4]
            ]
        solid = {"type": "Solid", "lod": "1", "boundaries": [faces]}
        roof = {"type": "MultiSurface", "lod": "0", "boundaries": faces[:1]}
        objects[key] = {"type": "Building", "attributes": tags, "geometry": [roof, solid]}
    objects["B4"] = {"type": "Building", "children": ["B3"]}
    objects["T"] = {"type": "SolitaryVegetationObject", "geometry": []}
    return {
        "type": "CityJSON", "version": "2.0", "CityObjects": objects, "vertices": vertices,
        "transform": {"scale": [0.01, 0.01, 0.01], "translate": [691000, 5334000, 0]},
        "metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/25832"},
    }  # fmt: skip


@pytest.mark.parametrize("sequence", [False, True])
def test_cityjson(sequence: bool, tmp_path: Path) -> None:
    document = cityjson()
    path = tmp_path / ("c.city.jsonl" if sequence else "c.city.json")
    if sequence:
        feature = {
            "type": "CityJSONFeature",
            "id": "all",
            **{key: document[key] for key in ("CityObjects", "vertices")},
        }
        head = {**document, "CityObjects": {}, "vertices": []}
        path.write_text(f"{json.dumps(head)}\n{json.dumps(feature)}\n", encoding="utf-8")
    else:
        path.write_text(json.dumps(document), encoding="utf-8")
    city, origin = load_buildings(path)
    assert (origin.lat_deg, origin.lon_deg) == pytest.approx((48.1306, 11.5679), abs=1e-3)
    assert [(b.id, b.height_m, round(b.shape.area)) for b in city.buildings] == [
        ("B1", 12.5, 600), ("B2", 6.0, 600), ("B3", 20.0, 600),
    ]  # fmt: skip
    assert city.reading is not None
    assert (city.reading.features, city.reading.kept, sum(city.reading.dropped.values())) == (5, 3, 2)
    assert city.reading.height_keys == {"measuredHeight": 1, "storeysAboveGround": 1, "3-D coordinates": 1}


def test_geojson_with_heights_in_its_coordinates(tmp_path: Path) -> None:
    faces = [
        [[8.545 + (x - 691000) * 1e-5, 47.397 + (y - 5334000) * 1e-5, z] for x, y, z in face]
        for face in box(0, 400, 417)
    ]
    row = {
        "type": "Feature",
        "properties": {},
        "geometry": {"type": "MultiPolygon", "coordinates": [[f] for f in faces]},
    }
    path = tmp_path / "c.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [row]}), encoding="utf-8")
    city, _ = load_buildings(path)
    assert city.buildings[0].height_m == 17.0
    assert city.buildings[0].shape.area == pytest.approx(30e-5 * 75_400 * 20e-5 * 111_200, rel=0.01)
    assert city.reading is not None
    assert city.reading.notes == ["no feature has a building tag, so every polygon counts as a building"]


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("c.parquet", b"", ["no", ".geojson", "ogr2ogr -f GeoJSON -t_srs EPSG:4326 city.geojson"]),
        ("c.geojson.gz", b"", ["gunzip --keep"]),
        ("c", b"", ["no extension", "ogr2ogr"]),
        ("c.shp", b"no shapefile", ["a .shp file", "ogrinfo"]),
        ("c.gpkg", b"", ["a .gpkg file", "ogrinfo"]),
        ("c.gml", b"<a/>", ["a CityGML CityModel", "ogr2ogr"]),
        ("c.gml", b"<a", ["XML"]),
        ("c.geojsonl", b'{"type": "Feature"}\n{"type"', ["line 2", "one JSON document a line"]),
        ("c.json", b'{"type": "CityJSON", "CityObjects": {}}', ["referenceSystem", "cjio"]),
        ("c.gpkg", None, ["no such file"]),
    ],
)
def test_what_cannot_be_read_says_what_to_do(
    file: str, content: bytes | None, words: list[str], tmp_path: Path
) -> None:
    path = tmp_path / file
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_buildings(path)
    assert caught.value.who == str(path)
    for word in words:
        assert word in str(caught.value)


def test_a_missing_coordinate_system_and_several_layers(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="-a_srs"):
        load_buildings(write_gdal(tmp_path / "c.fgb", "FlatGeobuf", {}, crs=None))
    path = tmp_path / "c.gpkg"
    for layer in ("north", "south"):
        write_gdal(path, "GPKG", {}, layer=layer, append=path.exists())
    with pytest.raises(InputError, match=r"north, south.*ogr2ogr -f FlatGeobuf"):
        load_buildings(path)


def test_a_file_of_another_format_is_refused(tmp_path: Path) -> None:
    """GDAL tells formats by their contents: a .shp could otherwise be a virtual file that reads others."""
    path = tmp_path / "c.shp"
    make_file("GeoJSON", tmp_path).rename(path)
    with pytest.raises(InputError, match=r"not recognized.*expected a \.shp file \(ESRI Shapefile\)"):
        load_buildings(path)


def test_without_the_extra_the_error_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make_file("FlatGeobuf", tmp_path)
    old = make_file("GeoJSON of 2008", tmp_path)
    for name in ("pyogrio", "pyproj"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=r"skyrange\[city\]"):
        load_buildings(path)
    with pytest.raises(InputError, match=r"skyrange\[city\]"):
        load_buildings(old)
    importlib.invalidate_caches()


def house(system: str, first: float, second: float) -> dict[str, Any]:
    """A CityJSON document of one house, with those two numbers in its positions."""
    corners = [(first + a, second + b) for a, b in ((0, 0), (2e-4, 0), (2e-4, 2e-4), (0, 2e-4))]
    shape = {"type": "MultiSurface", "lod": "1", "boundaries": [[[0, 1, 2, 3]], [[4, 5, 6, 7]]]}
    return {
        "type": "CityJSON", "version": "2.0", "metadata": {"referenceSystem": system},
        "CityObjects": {"H": {"type": "Building", "geometry": [shape]}},
        "vertices": [[*corner, height] for height in (0.0, 9.0) for corner in corners],
    }  # fmt: skip


PLACES = {"Lafayette": (40.4, -86.9), "Tokyo": (35.68, 139.76), "Zurich": (47.4, 8.5), "Lima": (-12.0, -77.0)}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("order", ["latitude", "longitude"])
@pytest.mark.parametrize("system", ["EPSG:4326", "EPSG:4979", "OGC:CRS84", "EPSG:4269", "EPSG:4258", "EPSG:6697"])
def test_the_order_of_degrees_is_that_of_their_area_and_told(
    system: str, order: str, place: str, tmp_path: Path
) -> None:
    """A city is where it is in one of the two orders; if both are possible, x is east, and the other can be chosen."""
    latitude, longitude = PLACES[place]
    path = tmp_path / "c.city.json"
    numbers = (latitude, longitude) if order == "latitude" else (longitude, latitude)
    path.write_text(json.dumps(house(system, *numbers)), encoding="utf-8")
    city, origin = load_buildings(path)
    assert city.reading is not None
    [note] = city.reading.notes
    right = (origin.lat_deg, origin.lon_deg) == pytest.approx((latitude, longitude), abs=1e-3)
    assert note.startswith(f"{order if right else 'longitude'} comes first")
    assert right or ("to choose the other order" in note and order == "latitude")
    if order == "longitude" or place == "Tokyo":
        assert right


def test_a_building_of_a_template_is_where_its_instance_is(tmp_path: Path) -> None:
    document = cityjson()
    faces = [[[8, 9, 10, 11]], [[0, 1, 2, 3]], [[4, 5, 6, 7]]]
    corners = [[0, 0], [10, 0], [10, 5], [0, 5]]
    document["geometry-templates"] = {
        "vertices-templates": [[*corner, height] for height in (0, 7, 14) for corner in corners],
        "templates": [{"type": "MultiSurface", "lod": "1", "boundaries": faces}],
    }
    turned = [0, -2, 0, 100, 2, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]  # by 90 degrees, twice as large, 100 m further east
    instance = {"type": "GeometryInstance", "template": 0, "boundaries": [0], "transformationMatrix": turned}
    document["CityObjects"] = {
        "B1": document["CityObjects"]["B1"], "T1": {"type": "Building", "geometry": [instance]},
        "E1": {"type": "Building", "geometry": []}, "P1": {"type": "Building", "children": ["B1"]},
    }  # fmt: skip
    path = tmp_path / "c.city.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    city, _ = load_buildings(path)
    b1, t1 = sorted(city.buildings, key=lambda building: building.id)
    assert (t1.id, t1.height_m, round(t1.shape.area)) == ("T1", 14.0, 200)
    west, south, east, north = (np.array(t1.shape.bounds) - np.array(b1.shape.bounds)[[0, 1, 0, 1]]).tolist()
    assert (east - west, north - south) == pytest.approx((10, 20), abs=1)  # the grid's north is a little off
    assert west == pytest.approx(90, abs=1)
    assert city.reading is not None
    assert city.reading.dropped == {
        "without surfaces": 1, "without surfaces of their own (the geometry of their parts counts)": 1,
    }  # fmt: skip
    document["metadata"]["referenceSystem"] = "EPSG:4326"
    document["transform"] = {"scale": [1e-7, 1e-7, 0.01], "translate": [8.5, 47.4, 0]}
    path.write_text(json.dumps(document), encoding="utf-8")
    city, _ = load_buildings(path)
    assert city.reading is not None
    assert city.reading.dropped["of a template, which is in metres, in a system of degrees"] == 1
