"""Is the world that Gazebo gets the scenario's: its names, bodies, buildings and ground?"""

from __future__ import annotations

import math
import os
import shutil
import struct
import subprocess
from collections import Counter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.city.downtown import downtown_grid
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.vehicle.gazebo.aircraft_model import PlacedAircraft, make_aircraft_model
from skyrange.vehicle.gazebo.building_models import box_of, make_city_models, prism_of, stl_bytes
from skyrange.vehicle.gazebo.sdf_elements import (
    GROUND,
    bar_between,
    building_name,
    city_name,
    format_numbers,
    model_name,
)
from skyrange.vehicle.gazebo.world_file import FILE, add_view, camera_place, write_world
from skyrange.world.airframes import AIRFRAMES, Airframe

ORIGIN = Origin(40.778, -73.955, 20.0, -32.7)
BLUE = (0.0, 0.4, 0.7)
FLEET = [
    PlacedAircraft("blue/1", "blue", "iris", 5.0, -5.0, 0.0, 90.0),
    PlacedAircraft("green/1", "green", "x500", -3.0, 1.5, 0.0, 200.0),
]
SHADOW = [PlacedAircraft("red/1", "red", "hummingbird", 0.0, 9.0, 30.0, 0.0)]
COURT = shapely.box(0, 0, 40, 30).difference(shapely.box(10, 10, 20, 20)).difference(shapely.box(25, 5, 30, 28))
L_SHAPE = shapely.Polygon([(0, 0), (30, 0), (30, 10), (10, 10), (10, 25), (0, 25)])
TWO = shapely.MultiPolygon([shapely.box(60, 0, 70, 10), L_SHAPE])

metres = st.floats(-1000.0, 1000.0, allow_subnormal=False)
lengths = st.floats(1.0, 100.0)


@st.composite
def footprints(draw: st.DrawFn) -> shapely.Geometry:
    """Unions of turned rectangles, some cut out again: concave, with holes, in one part or several."""
    shape = shapely.Polygon()
    for cut in (False, *draw(st.lists(st.booleans(), max_size=5))):
        east, north = draw(st.integers(-60, 60)), draw(st.integers(-60, 60))
        east, north = (0, 0) if shape.is_empty else (east, north)
        block = shapely.box(-draw(lengths), -draw(lengths), draw(lengths), draw(lengths))
        block = shapely.affinity.rotate(block, draw(st.integers(0, 89)), origin=(0, 0))
        block = shapely.affinity.translate(block, east, north)
        shape = shape.difference(block) if cut else shape.union(block)
    shape = shapely.set_precision(shape, 0.001)
    assume(shape.is_valid and shape.area > 1.0 and shape.geom_type in ("Polygon", "MultiPolygon"))
    return shape


def make_world(folder: Path, city: City | None = None, flavour: str = "classic", **changes: object) -> Path:
    arguments: dict[str, Any] = {
        "aircraft": FLEET,
        "mirrored": SHADOW,
        "city": city,
        "origin": ORIGIN,
        "wind_enu_mps": (3.0, -1.0, 0.0),
        "step_s": 0.0025,
        "flavour": flavour,
        "plugin": Path("/lib/libskyrange.so"),
    }
    return write_world(folder, **{**arguments, **changes})


def world_of(file: Path) -> ElementTree.Element:
    world = ElementTree.parse(file).getroot().find("world")
    assert world is not None
    return world


def numbers(element: ElementTree.Element, path: str) -> list[float]:
    return [float(part) for part in (element.findtext(path) or "").split()]


# ---------------------------------------------------------------- names


def test_a_model_has_the_vehicles_name() -> None:
    assert model_name("blue/1") == "blue.1"
    assert model_name("rid-city_2/b-1") == "rid-city_2.b-1"
    with pytest.raises(ValueError, match="id"):
        model_name("")


@given(st.lists(st.one_of(st.text("ab/._~:6", min_size=1), st.text(min_size=1)), unique=True, min_size=2, max_size=8))
def test_names_are_unique_and_valid(vehicles: list[str]) -> None:
    names = [model_name(vehicle) for vehicle in [*vehicles, city_name(0), GROUND, "world"]]
    assert len(set(names)) >= len(vehicles)
    assert len({model_name(vehicle) for vehicle in vehicles}) == len(vehicles)
    assert not {city_name(0), GROUND, "world"}.intersection(names)
    assert all("::" not in name and name.isascii() and name.isprintable() for name in names)
    assert not any(name.startswith("_") or " " in name for name in names)


def test_hostile_text_is_escaped(tmp_path: Path) -> None:
    hostile = PlacedAircraft('x"/><plugin name="&::', "<o>", "iris", 0.0, 0.0, 0.0, 0.0)
    plugin = Path('/tmp/a"<b>&.so')
    world = world_of(make_world(tmp_path, aircraft=[hostile], mirrored=[], plugin=plugin))
    assert [one.get("filename") for one in world.iter("plugin")] == [str(plugin)]
    assert [one.get("name") for one in world.findall("model")] == [GROUND, model_name(hostile.vehicle)]


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=6))
def test_numbers_read_back_unchanged(values: list[float]) -> None:
    assert [float(part) for part in format_numbers(*np.array(values)).split()] == values
    with pytest.raises(ValueError, match="infinite"):
        format_numbers(*values, math.nan)


# ---------------------------------------------------------------- aircraft


@given(st.sampled_from(sorted(AIRFRAMES)), metres, metres, st.floats(-720.0, 720.0))
def test_an_aircraft_is_its_airframe(name: str, east_m: float, north_m: float, heading_deg: float) -> None:
    airframe = AIRFRAMES[name]
    model = make_aircraft_model(PlacedAircraft("a/1", "a", name, east_m, north_m, 0.0, heading_deg), BLUE)
    x, y, z, roll, pitch, yaw = numbers(model, "pose")
    assert (x, y, z, roll, pitch) == (east_m, north_m, 0.0, 0.0, 0.0)
    nose = (math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg)))
    assert (math.cos(yaw), math.sin(yaw)) == pytest.approx(nose, abs=1e-12)
    (link,) = model.findall("link")
    assert numbers(link, "inertial/mass") == [airframe.mass_kg]
    assert numbers(link, "inertial/pose") == [0.0, 0.0, airframe.cg_height_m, 0.0, 0.0, 0.0]
    moments = [numbers(link, f"inertial/inertia/{tag}")[0] for tag in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")]
    assert moments == [*airframe.inertia_kgm2, 0.0, 0.0, 0.0]
    assert not list(model.iter("joint"))


@pytest.mark.parametrize("airframe", AIRFRAMES.values(), ids=AIRFRAMES)
def test_collisions_stand_on_the_gear_and_enclose_the_rotors(airframe: Airframe) -> None:
    link = make_aircraft_model(FLEET[0]._replace(airframe=airframe.name), BLUE).find("link")
    assert link is not None
    frame, *rotors = link.findall("collision")
    size, pose = numbers(frame, "geometry/box/size"), numbers(frame, "pose")
    assert pose[2] - 0.5 * size[2] == pytest.approx(0.0, abs=1e-12)
    assert size[:2] == [2.0 * airframe.gear_half_track_m] * 2
    assert [one.get("name") for one in rotors] == ["rotor_0", "rotor_1", "rotor_2", "rotor_3"]
    tops = []
    for one, rotor in zip(rotors, airframe.rotors, strict=True):
        x, y, z, *turns = numbers(one, "pose")
        assert (x, y, turns) == (rotor.forward_m, rotor.left_m, [0.0, 0.0, 0.0])
        assert numbers(one, "geometry/cylinder/radius") == [airframe.propeller_m]
        tops.append(z + 0.5 * numbers(one, "geometry/cylinder/length")[0])
        assert math.hypot(x, y) + airframe.propeller_m <= airframe.radius_m + 1e-12
    assert tops == pytest.approx([airframe.height_m] * 4)
    assert {one.text for one in link.iter("mu")} == {one.text for one in link.iter("mu2")} == {str(airframe.friction)}
    assert [one.get("name") for one in link.findall("visual")].count("rotor_0_visual") == 1


def test_a_mirrored_aircraft_only_shows() -> None:
    model = make_aircraft_model(SHADOW[0], BLUE, mirrored=True)
    assert model.findtext("static") == "true"
    assert not list(model.iter("collision"))
    assert not list(model.iter("inertial"))
    own = make_aircraft_model(SHADOW[0], BLUE)
    assert own.findtext("static") == "false"
    drawn = [[ElementTree.tostring(one) for one in each.iter("visual")] for each in (model, own)]
    assert drawn[0] == drawn[1]


def test_the_nose_is_drawn_in_another_colour() -> None:
    model = make_aircraft_model(FLEET[0], BLUE)
    colours = {
        one.get("name"): one.findtext("material/diffuse")
        for one in model.iter("visual")
        if one.get("name", "").startswith("rotor")
    }
    front, rear, left, right = (colours[f"rotor_{k}_visual"] for k in range(4))
    assert front == left != rear == right


@given(st.tuples(metres, metres, metres), st.tuples(metres, metres, metres))
def test_a_bar_joins_its_points(start: tuple[float, float, float], end: tuple[float, float, float]) -> None:
    centre, length, pitch, yaw = bar_between(start, end)
    axis = np.array([math.sin(pitch) * math.cos(yaw), math.sin(pitch) * math.sin(yaw), math.cos(pitch)])
    assert np.allclose(centre - 0.5 * length * axis, start, atol=1e-6)
    assert np.allclose(centre + 0.5 * length * axis, end, atol=1e-6)


# ---------------------------------------------------------------- buildings


@given(metres, metres, lengths, lengths, st.floats(-180.0, 180.0))
def test_a_box_is_its_rectangle(
    east_m: float, north_m: float, length_m: float, width_m: float, turn_deg: float
) -> None:
    shape = shapely.affinity.rotate(shapely.box(0, 0, length_m, width_m), turn_deg)
    shape = shapely.affinity.translate(shape, east_m, north_m)
    box = box_of(shape)
    assert box is not None
    again = shapely.box(-0.5 * box.length_m, -0.5 * box.width_m, 0.5 * box.length_m, 0.5 * box.width_m)
    again = shapely.affinity.rotate(again, box.yaw, origin=(0, 0), use_radians=True)
    again = shapely.affinity.translate(again, box.east_m, box.north_m)
    assert again.symmetric_difference(shape).area < 1e-6 * shape.area


@given(footprints())
def test_a_box_is_a_footprint_to_three_centimetres(shape: shapely.Geometry) -> None:
    box = box_of(shape)
    if box is not None:
        assert abs(box.length_m * box.width_m - shape.area) <= 0.03 * shape.length
        assert shape.geom_type == "Polygon"


def test_what_is_no_rectangle_is_no_box() -> None:
    notch = shapely.box(0, 0, 10, 10).difference(shapely.box(4, 9.9, 6, 10))
    wedge = shapely.box(0, 0, 10, 10).difference(shapely.Polygon([(4, -1), (6, -1), (5, 9.99)]))
    assert [box_of(shape) for shape in (COURT, L_SHAPE, TWO, notch, wedge)] == [None] * 5
    assert box_of(shapely.Point(0, 0).buffer(10)) is None
    assert box_of(shapely.box(0, 0, 10, 10).difference(shapely.box(4, 9.99, 6, 10))) is not None


@pytest.mark.parametrize("shape", [COURT, L_SHAPE, TWO], ids=["courtyards", "concave", "two parts"])
def test_known_prisms(shape: shapely.Geometry) -> None:
    check_prism(Building("b", 20.0, shape, base_m=5.0))


@given(footprints(), st.floats(0.0, 50.0), st.floats(1.0, 100.0))
def test_a_prism_is_closed_and_has_the_buildings_volume(shape: shapely.Geometry, base_m: float, tall_m: float) -> None:
    check_prism(Building("b", base_m + tall_m, shape, base_m=base_m))


def check_prism(building: Building) -> None:
    triangles = prism_of(building)
    edges = Counter((tuple(one[k]), tuple(one[(k + 1) % 3])) for one in triangles.tolist() for k in range(3))
    assert all(edges[end, start] == count for (start, end), count in edges.items())
    area_m2, tall_m = building.shape.area, building.height_m - building.base_m
    middle = triangles.mean(axis=(0, 1))
    a, b, c = (triangles[:, k] - middle for k in range(3))
    # positive if normals point outwards
    assert (np.cross(a, b) * c).sum() / 6.0 == pytest.approx(area_m2 * tall_m, rel=1e-6)
    normals = np.cross(b - a, c - a)
    roof = normals[:, 2] > 1e-9
    assert 0.5 * normals[roof, 2].sum() == pytest.approx(area_m2, rel=1e-6)
    assert set(triangles[roof][:, :, 2].ravel()) == {building.height_m}
    assert set(triangles[:, :, 2].ravel()) == {building.base_m, building.height_m}
    covered = shapely.union_all([shapely.Polygon(one[:, :2]) for one in triangles[roof]])
    assert covered.symmetric_difference(building.shape).area < 1e-6 * area_m2


def test_a_mesh_file_is_the_prism() -> None:
    triangles = prism_of(Building("b", 20.0, COURT))
    data = stl_bytes(triangles)
    assert not data.startswith(b"solid")  # which means a file of text
    assert struct.unpack_from("<I", data, 80) == (len(triangles),)
    assert len(data) == 84 + 50 * len(triangles)
    first = struct.unpack_from("<12f", data, 84)
    assert np.array(first[3:]).reshape(3, 3) == pytest.approx(triangles[0])
    assert math.hypot(*first[:3]) == pytest.approx(1.0)


def test_buildings_stand_where_the_city_says(tmp_path: Path) -> None:
    far = shapely.affinity.translate(L_SHAPE, 800.123, -400.5)
    city = City([Building("a", 30.0, shapely.box(5, 5, 15, 25), base_m=20.0), Building("b", 12.5, far)], "by hand")
    models = make_city_models(city, tmp_path)
    assert [one.get("name") for one in models] == [city_name(0), city_name(1)]  # far apart
    assert [one.findtext("static") for one in models] == ["true", "true"]
    box, mesh = (link for one in models for link in one.findall("link"))
    assert [one.get("name") for one in (box, mesh)] == [building_name(0), building_name(1)]
    assert numbers(box, "pose")[:3] == [10.0, 15.0, 25.0]
    assert sorted(numbers(box, "collision/geometry/box/size")) == [10.0, 10.0, 20.0]
    file = tmp_path / "building_1.stl"
    assert mesh.findtext("collision/geometry/mesh/uri") == f"file://{file.resolve()}"
    read = np.frombuffer(file.read_bytes()[84:], dtype=np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")]))
    corners = read["c"].reshape(-1, 3).astype(float) + numbers(mesh, "pose")[:3]
    assert corners.min(axis=0) == pytest.approx([*far.bounds[:2], 0.0], abs=1e-5)
    assert corners.max(axis=0) == pytest.approx([*far.bounds[2:], 12.5], abs=1e-5)


def test_an_older_shapely_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(shapely, "constrained_delaunay_triangles")
    with pytest.raises(InputError, match=r"2\.1"):
        prism_of(Building("b", 20.0, COURT))


# ---------------------------------------------------------------- world


@pytest.mark.parametrize("flavour", ["classic", "sim"])
def test_the_same_scenario_gives_the_same_bytes(tmp_path: Path, flavour: str) -> None:
    city = City([*downtown_grid((2, 2)).buildings, Building("court", 20.0, COURT)], "both")
    first = make_world(tmp_path, city, flavour)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    make_world(tmp_path, city, flavour)
    assert before == {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    assert first.name == FILE
    assert set(before) == {FILE, "building_16.stl"}


def test_the_world_is_the_scenarios(tmp_path: Path) -> None:
    world = world_of(make_world(tmp_path))
    assert [one.get("name") for one in world.findall("model")] == ["ground", "blue.1", "green.1", "red.1"]
    assert [one.findtext("static") for one in world.findall("model")] == ["true", "false", "false", "true"]
    assert numbers(world, "gravity") == [0.0, 0.0, -9.80665]
    assert numbers(world, "physics/max_step_size") == [0.0025]
    assert numbers(world, "wind/linear_velocity") == [3.0, -1.0, 0.0]
    place = world.find("spherical_coordinates")
    assert place is not None
    assert [numbers(place, tag)[0] for tag in ("latitude_deg", "longitude_deg", "elevation")] == [
        ORIGIN.lat_deg,
        ORIGIN.lon_deg,
        pytest.approx(-12.7),
    ]
    assert [(one.get("name"), one.get("filename")) for one in world.findall("plugin")] == [
        ("skyrange", "/lib/libskyrange.so")
    ]
    sim = [one.get("name") for one in world_of(make_world(tmp_path, flavour="sim")).findall("plugin")]
    assert sim[-1] == "skyrange::gazebo::Aircraft"
    assert "gz::sim::systems::Physics" in sim
    assert not world_of(make_world(tmp_path, plugin=None)).findall("plugin")


def test_the_ground_reaches_beyond_the_city(tmp_path: Path) -> None:
    city = downtown_grid((4, 2))
    world = world_of(make_world(tmp_path, city))
    east_m, north_m = numbers(world, "model[@name='ground']/link/visual/geometry/plane/size")
    assert 0.5 * min(east_m, north_m) > max(map(abs, city.bounds))
    links = {link.get("name"): link for link in world.iterfind("model/link")}
    assert len(world.findall("model")) > 1 + len(FLEET) + len(SHADOW) + 1  # several tiles
    for index, building in enumerate(city.buildings):
        link = links[building_name(index)]
        east, north, up, *_ = numbers(link, "pose")
        assert city.inside(east, north, up) is building


@pytest.mark.parametrize("flavour", ["classic", "sim"])
def test_the_names_of_siblings_differ(tmp_path: Path, flavour: str) -> None:
    city = City([*downtown_grid((2, 2)).buildings, Building("court", 20.0, COURT)], "both")
    for parent in world_of(make_world(tmp_path, city, flavour)).iter():
        if parent.tag in ("world", "model", "link"):
            names = [child.get("name") for child in parent if child.tag not in ("plugin", "physics")]
            names = [name for name in names if name is not None]
            assert len(set(names)) == len(names), parent.get("name")


def test_aircraft_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="id of its own"):
        make_world(tmp_path, mirrored=FLEET[:1])


@given(st.lists(st.tuples(metres, metres, st.floats(0.0, 100.0)), max_size=6))
def test_the_camera_sees_all_aircraft(places: list[tuple[float, float, float]]) -> None:
    fleet = [PlacedAircraft(f"a/{k}", "a", "iris", *place, 0.0) for k, place in enumerate(places)]
    world = ElementTree.Element("world")
    add_view(world, fleet, sim=False)
    east, north, up, _, pitch, yaw = numbers(world, "gui/camera/pose")
    assert (east, north, up) == camera_place(fleet)
    look = (math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), -math.sin(pitch))
    for place in places:
        away = np.subtract(place, (east, north, up))
        assert np.dot(away, look) >= math.cos(math.radians(30.1)) * np.linalg.norm(away)


def test_the_window_of_gazebo_sim_starts_at_the_camera(tmp_path: Path) -> None:
    world = world_of(make_world(tmp_path, flavour="sim"))
    assert numbers(world, "gui/plugin[@filename='MinimalScene']/camera_pose")[:3] == list(camera_place(FLEET + SHADOW))


# ---------------------------------------------------------------- Gazebo itself

NAMED = Path(os.environ.get("SKYRANGE_GAZEBO", ""))
GZ = str(NAMED) if NAMED.name == "gz" else shutil.which("gz")
NO_GAZEBO = "" if GZ else "gz is not on the PATH, and SKYRANGE_GAZEBO does not name it"


@pytest.mark.external(missing=NO_GAZEBO)
@pytest.mark.parametrize("flavour", ["classic", "sim"])
def test_gazebos_own_parser_accepts_the_world(tmp_path: Path, flavour: str) -> None:
    city = City([*downtown_grid((2, 2)).buildings, Building("court", 20.0, COURT)], "both")
    file = make_world(tmp_path, city, flavour)
    answer = subprocess.run([str(GZ), "sdf", "-k", file], capture_output=True, text=True, timeout=60, check=False)
    said = answer.stdout + answer.stderr
    assert answer.returncode == 0, said
    assert "Valid" in said or "Check complete" in said
    assert "rror" not in said
