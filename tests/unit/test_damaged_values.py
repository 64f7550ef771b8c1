"""Values that a reader could not use are refused when the file is read, by file, entry or column, and value."""

from __future__ import annotations

import itertools
import json
import re
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrange.core.errors import InputError
from skyrange.core.parquet_files import check_ranges, read_table
from skyrange.dataset.columns import VIEWS, view_schema
from skyrange.dataset.contents import RUNS
from skyrange.dataset.members import read_members
from skyrange.dataset.reading import read_runs, read_view
from skyrange.record import load
from skyrange.record.manifest import fleet_of, read_manifest, require_entry
from skyrange.scenario.validation.error_messages import UNIT_SUFFIXES, suggest_key
from skyrange.study.design.model import read_study
from skyrange.study.feature_windows import SCHEMA
from skyrange.twins.attribution import attribution_table
from skyrange.twins.pair_folder import FORMAT, load_pair

VEHICLE = {"id": "blue/b1", "operator": "blue"}
MANIFEST: dict[str, Any] = {
    "format": "skyrange.run/1", "status": "complete", "record": {"level": "full", "features_hz": 1.0},
}  # fmt: skip


def write_run(folder: Path, **entries: Any) -> Path:
    folder.mkdir()
    (folder / "manifest.json").write_text(json.dumps(MANIFEST | entries))
    return folder


@pytest.mark.parametrize(
    ("entries", "where"),
    [
        ({"vehicles": [VEHICLE | {"network": ""}]}, "vehicles.0.network"),
        ({"vehicles": [VEHICLE | {"uas_id": []}]}, "vehicles.0.uas_id"),
        ({"attacks": [{"id": "m", "kind": "k", "stop_s": "soon"}]}, "attacks.0.stop_s"),
        ({"faults": [{"id": "m", "kind": "k", "shown": {"a": [1.0]}}]}, "faults.0.shown.a"),
        ({"attacks": [{"id": "m", "kind": "k", "radios": [{}]}]}, "attacks.0.radios.0.endpoint"),
        (
            {"attacks": [{"id": "m", "kind": "k", "radios": [{"endpoint": "m.radio", "at_enu_m": [1.0]}]}]},
            "attacks.0.radios.0.at_enu_m",
        ),
        ({"defences": [{"id": "d"}]}, "defences.0.kind"),
        ({"constraints": [{"id": "c"}]}, "constraints.0.corners_m"),
        ({"medium": {"repeatable": "bytes", "builtin_waveforms": 3}}, "medium.builtin_waveforms"),
        ({"start_unix_ns": "12"}, "start_unix_ns"),
        ({"not_kept": {"frames": "many"}}, "not_kept.frames"),
    ],
)
def test_an_entry_of_another_type_is_named(entries: dict[str, Any], where: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=re.escape(f"manifest.json: {where}: ")):
        read_manifest(write_run(tmp_path / "run", **entries))


def test_an_attack_on_no_radio_of_the_scenario_has_no_place(tmp_path: Path) -> None:
    radio = {"endpoint": "m.radio", "at_enu_m": []}
    run = write_run(tmp_path / "run", attacks=[{"id": "m", "kind": "k", "radios": [radio]}])
    assert read_manifest(run)["attacks"][0]["radios"] == [radio]


def test_an_entry_that_is_needed_and_missing_is_named() -> None:
    assert fleet_of({"vehicles": [VEHICLE]}, "run") == ["blue/b1"]
    assert require_entry({"seed": 0}, "seed", "run") == 0
    for manifest in ({}, {"vehicles": None}):
        with pytest.raises(InputError, match=r"run: manifest\.json: vehicles: missing"):
            fleet_of(manifest, "run")


@pytest.mark.parametrize(
    ("values", "found"),
    [
        (pa.array([0, None, 9]), None),
        (pa.array([], pa.int64()), None),
        (pa.array([1, 2**63 - 1]), "9223372036854775807, in 1 of 2 rows"),
        (pa.array([-1, None, -1]), "-1, in 2 of 3 rows"),
        (pa.array([0.5, float("nan")]), "nan, in 1 of 2 rows"),
        (pa.array([float("inf")]), "inf, in 1 of 1 rows"),
    ],
)
def test_a_number_outside_its_range_is_named(values: pa.Array, found: str | None) -> None:
    table = pa.table({"a": values})
    if found is None:
        check_ranges(table, {"a": (0, 9), "b": (0, 1)}, "who", "a.parquet")
        return
    with pytest.raises(InputError) as caught:
        check_ranges(table, {"a": (0, 9), "b": (0, 1)}, "who", "a.parquet")
    (problem,) = caught.value.problems
    assert (problem.where, problem.value, problem.expected) == ("a.parquet: a", found, "a number from 0 to 9")


def view_file(folder: Path, view: str, **values: Any) -> Path:
    """A file of a view with one row: what `values` leaves out is null, false, 0 or empty."""
    row: dict[str, Any] = {}
    for column in VIEWS[view]:
        blank = False if column.type == pa.bool_() else "" if column.type == pa.string() else 0
        row[column.name] = values.get(column.name, None if column.nullable else blank)
    path = folder / f"view={view}" / "split=train" / "b.parquet"
    path.parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist([row], schema=view_schema(view)), path)
    return path


@pytest.mark.parametrize(
    ("view", "column", "value"),
    [
        ("flows", "bytes", 2**53 + 1),
        ("flows", "time_ns", -(2**63)),
        ("episodes", "onset_ns", -(2**63)),
        ("episodes", "effect_ns", 2**63 - 1),
    ],
)
def test_a_data_set_with_a_number_that_no_audit_can_use_is_refused(
    view: str, column: str, value: int, tmp_path: Path
) -> None:
    path = view_file(tmp_path, view, **{column: value})
    with pytest.raises(InputError, match=re.escape(f"view={view}/split=train/b.parquet: {column}: {value}, in 1")):
        read_view(tmp_path, view, path)


def test_an_episode_may_have_no_end(tmp_path: Path) -> None:
    path = view_file(tmp_path, "episodes", end_ns=2**63 - 1)
    assert read_view(tmp_path, "episodes", path).column("end_ns").to_pylist() == [2**63 - 1]


def write_pair(folder: Path, nominal: str = "blue/b1") -> Path:
    manifest = {"name": "x", "arms": ["nominal", "attacked"], "active": {}, "attacks": {}, "faults": [], "seeds": [4]}
    limits = {"baseline": None, "near_m": 5.0, "threshold_m": 1.0}
    folder.mkdir()
    (folder / "pair.json").write_text(json.dumps({"format": FORMAT, **manifest, **limits}))
    write_run(folder / "attacked", vehicles=[VEHICLE])
    write_run(folder / "nominal", vehicles=[VEHICLE | {"id": nominal}])
    return folder


@pytest.mark.parametrize(("column", "value"), [("level", -1.0), ("level", float("nan")), ("placebos", -1)])
def test_an_attribution_without_a_probability_is_refused(column: str, value: float, tmp_path: Path) -> None:
    folder = write_pair(tmp_path / "pair")
    row = {
        "seed": 4, "vehicle": "blue/b1", "outcome": "decisions", "attack": "m", "fault": False, "relation": "both",
        "difference": 1.0, "limit": 0.0, "placebos": 0, "level": 0.0, "shown": True,
    }  # fmt: skip
    pq.write_table(attribution_table([row]), folder / "attribution.parquet")
    assert load_pair(folder).attribution.num_rows == 1
    pq.write_table(attribution_table([row | {column: value}]), folder / "attribution.parquet")
    with pytest.raises(InputError, match=rf"attribution\.parquet: {column}: {value}, in 1 of 1 rows"):
        _ = load_pair(folder).attribution


def test_the_runs_of_a_pair_have_the_same_vehicles(tmp_path: Path) -> None:
    assert load_pair(write_pair(tmp_path / "pair")).run("nominal").status == "complete"
    with pytest.raises(InputError, match=r"manifest\.json: vehicles: blue/b2 — expected the vehicles of the attacked"):
        load_pair(write_pair(tmp_path / "other", "blue/b2")).run("nominal")


LONG = "x" * 300
"""A name that no file can have."""


@pytest.mark.parametrize("name", [LONG, f"folder/{LONG}", "a\0b"])
def test_a_name_that_no_file_can_have_is_refused_in_what_names_files(name: str, tmp_path: Path) -> None:
    row = {"folder": name, "block": "b", "arm": "nominal"}
    (tmp_path / "members.json").write_text(json.dumps({"runs": [row]}))
    with pytest.raises(InputError, match=r"runs\[0\]\.folder"):
        read_members(tmp_path / "members.json")
    (tmp_path / "s.toml").write_text("")
    toml_name = name.replace("\0", "\\u0000")
    factor = f'{{ name = "c", key = "buildings", values = ["{toml_name}/c.geojson", ""] }}'
    for expected, text in (
        ("a shipped scenario", f'scenario = "{toml_name}.toml"'),
        ("a file of buildings", f'scenario = "s.toml"\nfactors = [{factor}]'),
    ):
        (tmp_path / "study.toml").write_text(f'name = "s"\n{text}\n')
        with pytest.raises(InputError, match=expected):
            read_study(tmp_path / "study.toml")
    for entry, content in (("counts", 1), ("files", {})):
        run = write_run(tmp_path / entry, **{entry: {f"frames.parquet/{name}": content}})
        with pytest.raises(InputError, match=f"frames.parquet/{re.escape(name)}"):
            load(run)


@pytest.mark.parametrize("entry", ["height_m", "base_m"])
def test_a_building_higher_than_the_earth_is_refused(entry: str, tmp_path: Path) -> None:
    building = {"height_m": 9.0, "rings": [[[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]]]}
    run = write_run(tmp_path / "run")
    (run / "city.json").write_text(json.dumps([building]))
    assert load(run).city == [building]
    (run / "city.json").write_text(json.dumps([building | {entry: 2**53 + 1}]))
    with pytest.raises(InputError, match=rf"city\.json: 0\.{entry}"):
        _ = load(run).city


def test_a_window_of_no_vehicle_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "nominal.parquet"
    row = dict.fromkeys(SCHEMA.names, 0.0) | {"time_ns": 1, "link": "a/b>c", "vehicle": "a/b"}
    pq.write_table(pa.Table.from_pylist([row], schema=SCHEMA), path)
    assert read_table(path, "who", path.name, SCHEMA).num_rows == 1
    nullable = pa.schema([field.with_nullable(nullable=True) for field in SCHEMA])
    pq.write_table(pa.Table.from_pylist([row | {"vehicle": None}], schema=nullable), path)
    with pytest.raises(InputError, match=r"nominal\.parquet: vehicle"):
        read_table(path, "who", path.name, SCHEMA)


def test_a_key_with_any_other_unit_is_answered() -> None:
    for written, known in itertools.permutations(UNIT_SUFFIXES, 2):
        found = suggest_key(f"alt_{written}", 3.0, [f"alt_{known}"])
        assert found is not None
        assert found[0] == f"alt_{known}"
        assert f"Write alt_{known}" in found[1]


@pytest.mark.parametrize("name", ["x" * 40, "+".join(["abc"] * 60), "a\n", "*", "a/b", ""])
def test_a_block_whose_name_no_file_may_have_is_refused(name: str, tmp_path: Path) -> None:
    row = {"run": "r", "block": "a+b", "split": "train", "seed": 1, "repeats": True, "setting": "s"}
    (tmp_path / RUNS).parent.mkdir(exist_ok=True, parents=True)
    pq.write_table(pa.Table.from_pylist([row]), tmp_path / RUNS)
    assert read_runs(tmp_path) == [row]
    pq.write_table(pa.Table.from_pylist([row | {"block": name}]), tmp_path / RUNS)
    with pytest.raises(InputError, match="block"):
        read_runs(tmp_path)
