"""What a run's folder says of itself: the manifest as text, and the files put into it before the run starts."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory

from hypothesis import given
from hypothesis import strategies as st

from skyrange.assembly.placement.flight_plans import make_flight_plan, name_flight_plan
from skyrange.assembly.run_header import make_mission_files
from skyrange.core.geodesy import Origin
from skyrange.record import Recorder, load
from skyrange.record.folder import describe_file, describe_files
from skyrange.record.manifest import MANIFEST, write_manifest
from skyrange.record.verification import verify_run
from skyrange.scenario.model.scenario import Operator, Scenario, Vehicle, mission_file, path, square
from skyrange.scenario.model.scenario import Origin as ScenarioOrigin
from tests.unit.record_sample import HEADER, tell

values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
    max_leaves=20,
)


@given(st.dictionaries(st.text(max_size=6), values, max_size=5))
def test_the_manifest_reads_as_it_was_written(manifest: dict[str, object]) -> None:
    with TemporaryDirectory() as folder:
        write_manifest(Path(folder), manifest)
        assert json.loads((Path(folder) / MANIFEST).read_bytes()) == manifest


def test_the_manifest_has_a_line_for_each_entry_of_a_list(tmp_path: Path) -> None:
    write_manifest(tmp_path, {"name": "x", "links": [{"name": "a"}, {"name": "b"}], "timings": {"wall_s": 1.0}})
    assert (tmp_path / MANIFEST).read_text().splitlines() == [
        "{", '  "name": "x",', '  "links": [', '    {"name": "a"},', '    {"name": "b"}', "  ],",
        '  "timings": {', '    "wall_s": 1.0', "  }", "}",
    ]  # fmt: skip


def test_attached_files_are_described_as_they_are_on_the_disk(tmp_path: Path) -> None:
    recorder = Recorder.open(tmp_path / "run", HEADER)
    recorder.attach_files({"city.json": b"[]", "missions/flown/blue/b1.waypoints": b"QGC WPL 110\n"})
    recorder.attach_file("city.json", b"[1]")
    tell(recorder, 3)
    recorder.close()
    files = load(tmp_path / "run").manifest["files"]
    assert files == describe_files(tmp_path / "run")
    assert files["city.json"] == describe_file(tmp_path / "run" / "city.json", "test", "city.json")
    assert not verify_run(load(tmp_path / "run")).problems
    (tmp_path / "run" / "city.json").write_bytes(b"[2]")
    assert verify_run(load(tmp_path / "run")).problems


def test_a_file_that_another_program_changes_during_the_run_is_found(tmp_path: Path) -> None:
    """The manifest has the hash of what was attached; no file is read again at the end of the run."""
    recorder = Recorder.open(tmp_path / "run", HEADER)
    recorder.attach_file("city.json", b"[]")
    tell(recorder, 3)
    (tmp_path / "run" / "city.json").write_bytes(b"[1, 2]")
    recorder.close()
    (problem,) = verify_run(load(tmp_path / "run")).problems
    assert "city.json" in problem


def test_each_vehicle_has_a_mission_file_of_its_own() -> None:
    """Ids may have hyphens: a-b/c and a/b-c are two vehicles."""
    plan = square(5, 5)
    operators = (
        Operator(id="a", vehicles=(Vehicle(id="b-c", plan=plan),)),
        Operator(id="a-b", vehicles=(Vehicle(id="c", plan=plan),)),
    )
    scenario = Scenario(origin=ScenarioOrigin(lat=40.0, lon=-74.0), operators=operators)
    plans = {
        f"{operator.id}/{vehicle.id}": make_flight_plan(scenario.origin.datum, vehicle)
        for operator, vehicle in scenario.fleet
    }
    assert list(make_mission_files(plans)) == ["missions/flown/a/b-c.waypoints", "missions/flown/a-b/c.waypoints"]


def test_a_plan_is_named_without_making_it(tmp_path: Path) -> None:
    file = tmp_path / "m.waypoints"
    file.write_text("QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t40.0\t-74.0\t10\t1\n")
    origin = Origin(40.0, -74.0)
    for plan in (square(5, 5), path([(3, 4, 5)], mode="guided"), mission_file(str(file))):
        vehicle = Vehicle(plan=plan)
        assert name_flight_plan(vehicle) == make_flight_plan(origin, vehicle).name
