"""Does a GeoJSON file become the right city, and a bad one an error that says where?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Protocol

import pytest

from skyrange.city.building_files import load_buildings
from skyrange.city.city import City
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin

SQUARE = [[0.0, 0.0], [0.001, 0.0], [0.001, 0.001], [0.0, 0.001], [0.0, 0.0]]
HOLE = [[0.0004, 0.0004], [0.0006, 0.0004], [0.0006, 0.0006], [0.0004, 0.0006], [0.0004, 0.0004]]
BOW_TIE = [[0.0, 0.0], [0.001, 0.001], [0.001, 0.0], [0.0, 0.001], [0.0, 0.0]]
MANHATTAN = Path(__file__).parents[3] / "shared/data/cities/manhattan-upper-east-side.geojson"


class Load(Protocol):
    def __call__(self, features: list[Any], origin: Origin | None = None) -> tuple[City, Origin]: ...


def _feature(coordinates: object, kind: str = "Polygon", **tags: str) -> dict[str, Any]:
    tags = {"building": "yes"} | tags
    return {"type": "Feature", "properties": tags, "geometry": {"type": kind, "coordinates": coordinates}}


def _moved(ring: list[list[float]], east_deg: float) -> list[list[float]]:
    return [[lon + east_deg, lat] for lon, lat in ring]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def _load(features: list[Any], origin: Origin | None = None) -> tuple[City, Origin]:
        path = tmp_path / "city.geojson"
        path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
        return load_buildings(path, origin)

    return _load


def test_polygon_with_a_hole_around_its_own_middle(load: Load) -> None:
    """At the equator a thousandth of a degree is 111.32 m east and 110.57 m north (WGS 84 radii of curvature)."""
    city, origin = load([_feature([SQUARE, HOLE], height="12")])
    assert (origin.lat_deg, origin.lon_deg) == pytest.approx((0.0005, 0.0005))
    assert city.bounds == pytest.approx((-55.66, -55.287, 55.66, 55.287), abs=0.01)
    assert city.height_at(30.0, 30.0) == 12.0
    assert city.height_at(0.0, 0.0) == 0.0  # the courtyard
    assert city.height_at(60.0, 0.0) == 0.0


def test_given_origin_stays_and_shifts_the_city(load: Load) -> None:
    there = Origin(0.0, 0.0, 30.0, -5.0)
    city, origin = load([_feature([SQUARE])], there)
    assert origin is there
    assert city.bounds == pytest.approx((0.0, 0.0, 111.32, 110.574), abs=0.01)


def test_multipolygon_is_one_building_in_two_parts(load: Load) -> None:
    parts = [[SQUARE, HOLE], [_moved(SQUARE, 0.002)]]
    city, _ = load([_feature(parts, "MultiPolygon", height="9"), _feature([_moved(SQUARE, 0.004)], height="5")])
    assert [building.shape.geom_type for building in city.buildings] == ["MultiPolygon", "Polygon"]
    rows = city.to_json_rows()
    assert [(row["height_m"], len(row["rings"])) for row in rows] == [(9.0, 2), (9.0, 1), (5.0, 1)]
    assert all(ring[0] == ring[-1] and len(ring) == 5 for row in rows for ring in row["rings"])
    json.dumps(rows)


def test_ignores_and_counts_what_is_no_building(load: Load) -> None:
    features = [
        _feature([SQUARE], height="30"),
        _feature([SQUARE], building="no"),
        _feature([0.0, 0.0], "Point"),
        {"type": "Feature", "properties": {"highway": "steps"}, "geometry": {"type": "LineString", "coordinates": []}},
        {"type": "Feature", "properties": None, "geometry": None},
        _feature([_moved(SQUARE, 0.002)], **{"building": "no", "building:part": "yes", "building:levels": "4"}),
        _feature([_moved(SQUARE, 0.004)]),
    ]
    city, _ = load(features)
    told = city.reading
    assert told is not None
    assert (told.features, told.kept, told.repaired) == (7, 3, 0)
    assert told.dropped == {"with building=no": 1, "of type Point": 1, "of type LineString": 1, "without geometry": 1}
    assert told.heights == {"measured": 1, "derived": 1, "defaulted": 1}
    assert told.height_keys == {"height": 1, "building:levels": 1}
    assert [building.height_m for building in city.buildings] == [30.0, 12.0, 9.0]


def test_crossing_ring_is_repaired_and_flat_one_left_out(load: Load) -> None:
    flat = [[0.0, 0.0], [0.001, 0.0], [0.0005, 0.0], [0.0, 0.0]]
    city, _ = load([_feature([BOW_TIE], height="10"), _feature([flat])])
    told = city.reading
    assert told is not None
    assert (told.repaired, told.dropped["without area"], len(city)) == (2, 1, 1)
    assert city.buildings[0].shape.is_valid
    assert city.buildings[0].shape.area == pytest.approx(0.5 * 111.32 * 110.574, rel=1e-3)


def test_ids_come_from_the_feature_and_are_unique(load: Load) -> None:
    twice = [_feature([SQUARE], **{"@id": "way/1", "name": "Hall"}), _feature([SQUARE], **{"@id": "way/1"})]
    city, _ = load([*twice, _feature([SQUARE])])
    assert [building.id for building in city.buildings] == ["way/1", "way/1 features[1]", "features[2]"]
    assert city.buildings[0].name == "Hall"


def test_raised_part_keeps_its_base(load: Load) -> None:
    city, _ = load([_feature([SQUARE], height="20", min_height="8")])
    assert city.buildings[0].base_m == 8.0
    assert city.to_json_rows()[0]["base_m"] == 8.0
    assert city.inside(0.0, 0.0) is None
    assert city.inside(0.0, 0.0, 8.0) is city.buildings[0]


@pytest.mark.parametrize(
    ("feature", "problem"),
    [
        (7, "int"),
        (_feature([SQUARE[:3]]), "ring of 3 positions"),
        (_feature([SQUARE[:4]]), "the last equal to the first"),
        (_feature([[[0, 0], [1, 0], [1], [0, 0]]]), "[longitude, latitude] positions"),
        (_feature([[["a", "b"]] * 4]), "[longitude, latitude] positions"),
        (_feature([[[None, 0]] * 4]), "[longitude, latitude] positions"),
        (_feature([[[0, 0], [0, 91], [1, 1], [0, 0]]]), "position [0, 91]"),
        (_feature([[[0, 0], [float("nan"), 0], [1, 1], [0, 0]]]), "position [nan, 0]"),
        (_feature([]), "a list of rings"),
        (_feature([5]), "positions"),
        (_feature("far", "MultiPolygon"), "a list of rings"),
        (_feature([[]], "MultiPolygon"), "a list of rings"),
        ({"properties": [], "geometry": {}}, "objects or null"),
    ],
)
def test_bad_feature_is_named_by_its_index(load: Load, feature: object, problem: str) -> None:
    with pytest.raises(InputError) as caught:
        load([_feature([SQUARE]), feature])
    (fault,) = caught.value.problems
    assert fault.where == "features[1]"
    assert problem in str(fault)


def test_all_bad_features_are_told_at_once_up_to_a_number(load: Load) -> None:
    with pytest.raises(InputError) as caught:
        load([_feature([SQUARE[:3]])] * 3 + [_feature([SQUARE])])
    assert [fault.where for fault in caught.value.problems] == ["features[0]", "features[1]", "features[2]"]
    with pytest.raises(InputError) as caught:
        load([_feature([SQUARE[:3]])] * 25)
    assert len(caught.value.problems) == 21
    assert "5 more" in str(caught.value)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "line 1, column 1"),
        (b'{"type": "FeatureCollection", "features": [', "line 1"),
        (b"\xff\xfe\xfa", "UTF-8"),
        (b"[" * 100_000, "nested too deeply"),
        (b"[1, 2]", "FeatureCollection"),
        (b'{"type": "Topology"}', "'Topology'"),
        (b'{"type": "FeatureCollection", "features": {}}', "a list of features"),
        (b'{"type": "FeatureCollection", "features": []}', "0 features, no building"),
    ],
)
def test_corrupt_files(tmp_path: Path, content: bytes, problem: str) -> None:
    path = tmp_path / "broken.geojson"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_buildings(path)
    assert problem in str(caught.value)
    assert caught.value.who == str(path)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_buildings(tmp_path / "none.geojson")


def test_buildings_a_continent_apart_are_no_city(load: Load) -> None:
    with pytest.raises(InputError, match="one city"):
        load([_feature([SQUARE]), _feature([_moved(SQUARE, 90.0)])])


@pytest.mark.skipif(not MANHATTAN.exists(), reason="the Manhattan extract is not beside the project")
def test_manhattan() -> None:
    """Its 1,239 polygons are buildings, its 47 points are not; 1,228 have a height tag, as its own note says."""
    city, origin = load_buildings(MANHATTAN)
    told = city.reading
    assert told is not None
    assert (told.features, told.kept, told.repaired, told.dropped) == (1286, 1239, 1, {"of type Point": 47})
    assert told.heights == {"measured": 1228, "derived": 2, "defaulted": 9}
    assert (origin.lat_deg, origin.lon_deg) == pytest.approx((40.77834, -73.95468), abs=1e-4)
    west, south, east, north = city.bounds
    assert (east - west, north - south) == pytest.approx((1054.0, 908.0), abs=2.0)
    assert all(building.shape.is_valid for building in city.buildings)
