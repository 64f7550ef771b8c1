"""Radio maps without a ray tracer: places, meshes, parts on disk, and every refusal before tracing begins."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest
import shapely
from typer.testing import CliRunner

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.city.downtown import downtown_grid
from skyrange.cli.app import app
from skyrange.core.errors import InputError
from skyrange.figures.maps import draw_coverage_map
from skyrange.radio.propagation.loss_table_file import read_loss_table
from skyrange.radio_map import sionna
from skyrange.radio_map.city_mesh import city_mesh
from skyrange.radio_map.mapping import MapLayout, is_outside, prepare_map, trace_map, transmitter_places
from tests.loss_tables import TRACER, ExcessTracer, make_table

CITY = downtown_grid((2, 2), (20.0, 30.0), 1, 24.0, 72.0)
LAYOUT = MapLayout(CITY.bounds, spacing_m=20.0, heights_m=(2.0, 40.0), transmitter_spacing_m=80.0)
FIXED = [(0.0, 0.0, 6.0)]


def test_the_grid_fills_the_area_with_points_in_the_middle_of_squares() -> None:
    grid = MapLayout((0.0, 0.0, 100.0, 40.0), spacing_m=20.0, heights_m=(2.0,)).grid
    assert grid.shape == (1, 2, 5)
    assert grid.points_enu_m[0, :, :, 0].min() == 10.0
    assert grid.points_enu_m[0, :, :, 0].max() == 90.0
    assert grid.points_enu_m[0, :, 0, 1].tolist() == [10.0, 30.0]
    wider = MapLayout((0.0, 0.0, 90.0, 40.0), spacing_m=20.0).grid
    assert (wider.columns, wider.west_m) == (5, 5.0)


def test_transmitters_are_the_fixed_places_and_a_grid_outside_buildings() -> None:
    places = transmitter_places(LAYOUT, CITY, FIXED * 2)
    assert places[0].tolist() == [0.0, 0.0, 6.0]
    assert len(places) > 4
    assert (places[1:, 2] == 60.0).all()
    assert len(np.unique(places, axis=0)) == len(places)
    low = transmitter_places(MapLayout(CITY.bounds, transmitter_spacing_m=10.0, transmitter_heights_m=(2.0,)), CITY, [])
    assert all(CITY.inside(*place) is None for place in low.tolist())


def test_every_fault_of_a_layout_is_told_at_once() -> None:
    bad = MapLayout((0.0, 0.0, -1.0, 5.0), 0.1, (5.0, 5.0), 0.0, ())
    with pytest.raises(InputError) as caught:
        bad.check()
    assert [fault.where for fault in caught.value.problems] == ["area", "spacing", "transmitter spacing", "heights"]
    with pytest.raises(InputError, match=r"receivers: .* — expected at most 500,000"):
        MapLayout((0.0, 0.0, 1e4, 1e4)).check()
    with pytest.raises(InputError, match=r"transmitters: .* — expected at most 400"):
        transmitter_places(MapLayout((0.0, 0.0, 1e4, 1e4), transmitter_spacing_m=10.0), CITY, [])
    middle = CITY.buildings[0].shape.representative_point()
    inside = (middle.x - 1.0, middle.y - 1.0, middle.x + 1.0, middle.y + 1.0)
    with pytest.raises(InputError, match="at least one transmitter outside buildings"):
        transmitter_places(MapLayout(inside, transmitter_heights_m=(2.0,)), CITY, [])


def test_a_mesh_has_the_walls_roofs_and_raised_floors_of_its_buildings() -> None:
    ring = shapely.Polygon([(0, 0), (30, 0), (30, 20), (0, 20)], [[(10, 5), (20, 5), (20, 15), (10, 15)]])
    bridge = shapely.box(40, 0, 50, 10)
    city = City([Building("a", 12.0, ring), Building("b", 12.0, bridge, base_m=8.0)], "test")
    vertices, faces = city_mesh(city)
    assert len(np.unique(vertices, axis=0)) == len(vertices) == 2 * (8 + 4)
    corners = vertices[faces].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    level = np.ptp(corners[:, :, 2], axis=1) == 0.0
    assert area[~level].sum() == pytest.approx(12.0 * (100.0 + 40.0) + 4.0 * 40.0)
    assert area[level & (normal[:, 2] > 0)].sum() == pytest.approx(500.0 + 100.0)
    assert area[level & (normal[:, 2] < 0)].sum() == pytest.approx(100.0)
    assert (corners[level & (normal[:, 2] < 0)][:, :, 2] == 8.0).all()


def test_an_interrupted_map_continues_and_gives_the_same_bytes(tmp_path: Path) -> None:
    make_table(tmp_path / "whole.parquet", CITY, LAYOUT, FIXED)
    job = prepare_map(CITY, LAYOUT, FIXED, 2437.0, TRACER, tmp_path / "cut.parquet")
    first = ExcessTracer(20.0, fail_after=2)
    with pytest.raises(KeyboardInterrupt):
        trace_map(job, first)
    assert not job.path.exists()
    (job.parts / "0001.npy").write_bytes(b"cut short")
    again = prepare_map(CITY, LAYOUT, FIXED, 2437.0, TRACER, tmp_path / "cut.parquet")
    second, told = ExcessTracer(20.0), []
    trace_map(again, second, lambda done, total, left_s: told.append((done, total, left_s is None)))
    assert len(second.traced) == len(job.places_enu_m) - 1
    assert first.traced[0] not in second.traced
    assert told[-1][:2] == (len(job.places_enu_m), len(job.places_enu_m))
    assert (tmp_path / "cut.parquet").read_bytes() == (tmp_path / "whole.parquet").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cut.parquet", "whole.parquet"]


def test_parts_of_another_map_are_refused(tmp_path: Path) -> None:
    out = tmp_path / "m.parquet"
    prepare_map(CITY, LAYOUT, FIXED, 2437.0, TRACER, out)
    with pytest.raises(InputError, match="parts of another map"):
        prepare_map(CITY, LAYOUT, [], 2437.0, TRACER, out)
    with pytest.raises(InputError, match="parts of another map"):
        prepare_map(CITY, LAYOUT, FIXED, 2437.0, {"name": "other"}, out)


def test_an_output_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    for out, said in ((tmp_path, "a folder"), (tmp_path / "none" / "m.parquet", "missing or read-only")):
        with pytest.raises(InputError, match=said):
            prepare_map(CITY, LAYOUT, FIXED, 2437.0, TRACER, out)


def test_points_inside_buildings_have_no_value(tmp_path: Path) -> None:
    content = make_table(tmp_path / "m.parquet", CITY, LAYOUT, FIXED)
    np.testing.assert_array_equal(np.isfinite(content.loss_db[0]), is_outside(CITY, content.header.grid.grid))
    assert 0.2 < np.isnan(content.loss_db[0, 0]).mean() < 0.9
    assert np.isfinite(content.loss_db[0, 1]).all()
    assert read_loss_table(tmp_path / "m.parquet").header.buildings == CITY.digest()


def test_the_picture_has_a_square_for_every_value_and_a_key(tmp_path: Path) -> None:
    content = make_table(tmp_path / "m.parquet", CITY, LAYOUT, FIXED)
    low = draw_coverage_map(content, CITY.to_json_rows())
    high = draw_coverage_map(content, (), 0, 1_000.0)
    assert "at 2 m above the ground, 2437 MHz" in low.title
    assert "at 40 m above the ground" in high.title
    assert low.svg.count("<rect") == 7
    assert low.svg != high.svg


def refusal(*arguments: str) -> str:
    """What the command line says against some arguments."""
    result = CliRunner().invoke(app, ["radio", *arguments])
    assert isinstance(result.exception, InputError), result.output
    return str(result.exception)


def test_a_missing_program_is_named_with_its_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = str(tmp_path / "m.parquet")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert "pip install 'skyrange[sionna]'" in refusal("map", "rid-city", "-o", out)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(sionna, "_FOLDERS", (str(tmp_path),))
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    assert "apt-get install libllvm19" in refusal("map", "rid-city", "-o", out)
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "none.so"))
    assert str(tmp_path / "none.so") in refusal("map", "rid-city", "-o", out)
    assert list(tmp_path.iterdir()) == []


def test_the_newest_llvm_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(sionna, "_FOLDERS", (str(tmp_path),))
    assert sionna.find_llvm() is None
    for name in ("libLLVM-14.so.1", "libLLVM.so.19.1", "libLLVM-15.so", "libLLVMPolly.so", "libLLVM-x.so"):
        (tmp_path / name).touch()
    found = sionna.find_llvm()
    assert found is not None
    assert found.name == "libLLVM.so.19.1"


def test_arguments_that_cannot_be_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "a scenario, or --buildings FILE" in refusal("map")
    assert "a scenario with buildings" in refusal("map", "squares")
    assert "1000 to 1e+08" in refusal("map", "rid-city", "--samples", "1")
    assert "no such file" in refusal("show", str(tmp_path / "none"))
    make_table(tmp_path / "m.parquet", CITY, LAYOUT, FIXED)
    asked = ("show", str(tmp_path / "m.parquet"), "--picture", str(tmp_path / "p.svg"))
    assert "expected 0 to" in refusal(*asked, "--transmitter", "99")
    monkeypatch.setattr(sionna, "check_installed", lambda: None)
    monkeypatch.setattr(sionna, "describe_tracer", lambda settings: TRACER)
    out = str(tmp_path / "n.parquet")
    assert "at most 400" in refusal("map", "rid-city", "-o", out, "--transmitter-spacing", "5")


def test_a_map_and_its_picture_from_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sionna, "check_installed", lambda: None)
    monkeypatch.setattr(sionna, "describe_tracer", lambda settings: TRACER)
    monkeypatch.setattr(sionna, "SionnaTracer", lambda city, settings: ExcessTracer(10.0))
    out, picture = tmp_path / "m.parquet", tmp_path / "p.svg"
    coarse = ["--transmitter-spacing", "400", "--spacing", "50", "--height", "2", "--height", "60"]
    said = CliRunner().invoke(
        app, ["radio", "map", "rid-city", "-o", str(out), *coarse, "--picture", str(picture)], env={"COLUMNS": "160"}
    )
    assert said.exit_code == 0, said.output
    content = read_loss_table(out)
    assert "6 transmitters, 19 x 19 receivers 50 m apart at 2, 60 m; 400 buildings" in said.output
    assert "6 of 6 transmitters" in said.output
    assert content.places_enu_m[0].tolist()[2] == 6.0  # the scenario's first ground receiver
    assert content.header.tracer == TRACER
    assert picture.read_text().startswith("<?xml")
    told = CliRunner().invoke(app, ["radio", "show", str(out), "--json"])
    assert '"transmitters": 6' in told.stdout
