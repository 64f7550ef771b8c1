"""Data sets of real flights: labels, blocks, files that other tools open, and what flies a run again."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrange.core.errors import InputError
from skyrange.dataset import build
from skyrange.dataset.audit.arms import read_arms
from skyrange.dataset.build import build_dataset
from skyrange.dataset.columns import VIEWS, view_schema
from skyrange.dataset.croissant import CONFORMS_TO
from skyrange.dataset.frame_views import Place
from skyrange.dataset.members import Member, read_members
from skyrange.dataset.progress import begin_build
from skyrange.dataset.views import ViewSettings, run_views
from skyrange.record import RunRecord, load
from skyrange.scenario.toml_files import load_text
from skyrange.study.measurement import measure_acts
from skyrange.study.runs import fly
from skyrange.twins.arms import Arm, scenario_of

pytestmark = pytest.mark.rotating

BOTH = ViewSettings(places=(Place("gcs:*", "gcs"), Place("gcs:*", "companion")))
BASE = """
name = "sample"
seed = 3
duration_s = 18
origin = { lat = 40.7780, lon = -73.9550, alt_msl_m = 20, geoid_m = -32.7 }

[radio]

[[radio.receivers]]
id = "corner"
operator = "blue"
place = [8, 0, 3]

[[operators]]
id = "blue"
streams = "operator"
approval = "authority"
request_ahead_s = 3
margins = { horizontal_m = 6, late_s = 8, drift = 0.1 }
  [[operators.vehicles]]
  id = "b1"
  plan = { path = { points = [[0, 0], [0, 60]], alt_m = 15 }, speed_mps = 5, end = "land" }
  [[operators.vehicles]]
  id = "b2"
  start = [-60, 0]
  plan = { path = { points = [[0, 0], [0, 60]], alt_m = 15 }, speed_mps = 5, end = "land" }

[[attacks]]
id = "mallory"
start_s = 12
"""
ONSET_NS = 12_000_000_000
ATTACKS = {
    "mode": ('kind = "mavlink.mode"\nparams = { vehicles = ["blue/b1"], mode = "LAND" }', "train"),
    "drift": ('kind = "gnss.drift"\nparams = { vehicles = ["blue/b1"], rate_mps = [0.5, 0, 0] }', "heldout_family"),
    "drop": ('kind = "link.drop"\nparams = { links = ["gcs:blue/b1"], direction = "rev", probability = 0.5 }', "test"),
}
ARMS = {"nominal": frozenset[str](), "attacked": frozenset({"mallory"}), "sham": frozenset[str]()}


class Sample(NamedTuple):
    members: list[Member]
    folder: Path


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Sample:
    """Three blocks of real flights, and the data set made of them."""
    base = tmp_path_factory.mktemp("dataset")
    members = []
    for seed, (block, (attack, split)) in enumerate(ATTACKS.items(), start=3):
        scenario = load_text(BASE + attack)
        for arm, active in ARMS.items():
            if (arm == "sham" and block != "mode") or (block, arm) == ("drift", "nominal"):
                continue
            record = fly(scenario_of(scenario, Arm(arm, active), seed), base / f"{block}-{arm}", report=False)
            effects = {"blue/b1": 14.0 if active else None, "blue/b2": None}
            text = (record.path / "scenario.toml").read_text()
            members.append(Member(record.path, block, arm, split, {"draw": 1}, seed, text, effects))
    folder = build_dataset(members[::-1], base / "sample", "sample", settings=BOTH)
    return Sample(members, folder)


def rows(sample: Sample, view: str, run: str) -> list[dict[str, Any]]:
    found = pq.read_table(sample.folder / f"view={view}", filters=[("run", "=", run)])
    listed: list[dict[str, Any]] = found.to_pylist()
    return listed


def test_every_view_has_its_declared_columns(sample: Sample) -> None:
    for view in VIEWS:
        files = sorted(sample.folder.glob(f"view={view}/split=*/*.parquet"))
        assert len(files) == len(ATTACKS), view
        for file in files:
            assert pq.read_schema(file).equals(view_schema(view), check_metadata=False)
            assert pq.read_schema(file).field("run").metadata[b"role"] == b"bookkeeping"


def test_an_injected_frame_is_hostile_at_the_companion_and_its_answer_derived_at_the_station(sample: Sample) -> None:
    frames = rows(sample, "mavlink", "mode.attacked")
    hostile = [row for row in frames if row["hostile"]]
    assert {(row["place"], row["received"], row["message"]) for row in hostile} == {
        ("blue/b1.companion", True, "COMMAND_LONG")
    }
    assert hostile[0]["src"] == "blue.gcs"  # as claimed: the true sender is no column
    assert hostile[0]["family"] == "command_injection"
    derived = {row["message"] for row in frames if row["derived"] and row["place"] == "blue.gcs"}
    assert "COMMAND_ACK" in derived
    assert not any(row["derived"] or row["hostile"] for row in frames if row["link"] == "gcs:blue/b2")
    assert "mallory" not in {value for row in frames for name, value in row.items() if name in ("src", "dst", "place")}


def test_telemetry_of_a_falsified_estimate_is_derived(sample: Sample) -> None:
    frames = [row for row in rows(sample, "mavlink", "drift.attacked") if row["place"] == "blue.gcs"]
    false = [row for row in frames if row["derived"]]
    assert false
    assert {row["way"] for row in false} == {"estimate"}
    assert {row["link"] for row in false} == {"gcs:blue/b1"}
    assert min(row["time_ns"] for row in false) >= ONSET_NS
    assert "GLOBAL_POSITION_INT" in {row["message"] for row in false}
    assert "HEARTBEAT" not in {row["message"] for row in false}
    said = [row for row in rows(sample, "remote_id", "drift.attacked") if row["derived"]]
    assert {row["radio"] for row in said} == {"blue/b1"}


def test_dropped_frames_are_observable_where_they_are_missing(sample: Sample) -> None:
    flows = rows(sample, "flows", "drop.attacked")
    shown = {(row["place"], row["link"], row["received"]) for row in flows if row["observable"]}
    assert shown == {("blue.gcs", "gcs:blue/b1", True)}
    assert not any(row["hostile_frames"] for row in flows)
    assert all(row["active"] for row in flows if row["observable"])


def test_active_observable_and_effect_are_told_apart(sample: Sample) -> None:
    flows = [
        row
        for row in rows(sample, "flows", "mode.attacked")
        if row["link"] == "gcs:blue/b1" and row["place"] == "blue.gcs" and row["received"]
    ]
    active = [row["window"] for row in flows if row["active"]]
    assert active == [12]
    assert next(row["window"] for row in flows if row["observable"]) == 12
    assert [row["window"] for row in flows if row["effect"]] == list(range(14, 18))
    assert [row["window"] for row in flows if row["after_onset"]] == list(range(12, 18))
    (episode,) = rows(sample, "episodes", "mode.attacked")
    assert episode["onset_ns"] == ONSET_NS
    assert ONSET_NS < episode["observable_ns"] < ONSET_NS + 1_000_000_000
    assert episode["effect_ns"] == 14_000_000_000
    (sham,) = rows(sample, "episodes", "mode.sham")
    assert (sham["role"], sham["effect_ns"]) == ("harmless_intrusion", None)


def test_frames_of_somebody_unauthorised_that_harm_nobody_have_a_label_of_their_own(sample: Sample) -> None:
    frames = rows(sample, "mavlink", "mode.sham")
    own = [row for row in frames if row["harmless_intrusion"]]
    assert {row["message"] for row in own if row["steps"] == 0} == {"COMMAND_LONG"}
    assert not any(row["hostile"] or row["derived"] or row["sham"] for row in frames)
    (act,) = measure_acts(load(next(one.record for one in sample.members if one.arm == "sham")))
    assert (act["harmless_intrusion"], act["fault"], act["vehicle"], act["first_s"]) == (True, False, "blue/b1", 12.0)
    assert act["effect_end_s"] == act["last_s"]
    windows = rows(sample, "flows", "mode.sham")
    assert 12 in {row["window"] for row in windows if row["harmless_intrusion_active"]}
    assert not any(row["active"] or row["observable"] or row["sham_active"] for row in windows)


def test_arms_share_their_windows_up_to_the_onset(sample: Sample) -> None:
    for view in ("flows", "aircraft", "mavlink"):
        attacked = rows(sample, view, "mode.attacked")
        elsewhere = {row["duplicate_of"] for row in rows(sample, view, "mode.nominal")}
        assert elsewhere <= {None, "drift.attacked", "drop.nominal"}, "windows of another split, before chance acts"
        onset = ONSET_NS // (500_000_000 if view == "aircraft" else 1_000_000_000)
        assert all(row["duplicate_of"] == "mode.nominal" for row in attacked if row["window"] < onset - 1)
        assert any(row["duplicate_of"] is None for row in attacked)
    once = {
        (row["link"], row["place"], row["window"], row["content_hash"])
        for row in rows(sample, "mavlink", "mode.nominal")
    }
    assert len(once) == len({key[:3] for key in once})


def test_flows_count_the_frames(sample: Sample) -> None:
    frames = rows(sample, "mavlink", "mode.attacked")
    flows = rows(sample, "flows", "mode.attacked")
    assert sum(row["frames"] for row in flows) == len(frames)
    assert sum(row["bytes"] for row in flows) == sum(len(row["raw"]) for row in frames)
    assert sum(row["hostile_frames"] for row in flows) == sum(row["hostile"] for row in frames) == 1
    one = next(row for row in flows if row["frames"] > 10)
    same = [
        row for row in frames
        if all(row[key] == one[key] for key in ("place", "link", "received", "window"))
    ]  # fmt: skip
    assert one["message_kinds"] == len({row["message_id"] for row in same})
    gaps = [(after["time_ns"] - before["time_ns"]) / 1e6 for before, after in pairwise(same)]
    assert one["iat_mean_ms"] == pytest.approx(sum(gaps) / len(gaps))
    assert one["iat_max_ms"] == pytest.approx(max(gaps))


def test_aircraft_have_what_the_station_received_last(sample: Sample) -> None:
    vehicle = [row for row in rows(sample, "aircraft", "mode.nominal") if row["vehicle"] == "blue/b1"]
    assert [row["time_ns"] for row in vehicle[:2]] == [500_000_000, 1_000_000_000]
    last = vehicle[-1]
    assert last["lat_deg"] == pytest.approx(40.778, abs=0.001)
    assert 0.0 <= last["ekf_horizontal_ratio"] < 1.0
    assert 0.0 <= last["heartbeat_age_s"] <= 1.2


def open_lines(sample: Sample, view: str) -> list[str]:
    """The lines of the README that open a view, one for each tool."""
    block = (sample.folder / "README.md").read_text().partition("```python\n")[2].partition("```")[0]
    return block.replace("flows", view).splitlines()


@pytest.mark.parametrize("view", VIEWS)
def test_each_tool_opens_each_view_with_the_line_of_the_readme(
    sample: Sample, view: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    tools = {name: pytest.importorskip(name) for name in ("polars", "duckdb", "pandas")}
    monkeypatch.chdir(sample.folder.parent)
    count = pq.read_table(f"sample/view={view}").num_rows
    opened = [
        eval(line, {name: tools[name]}) for line in open_lines(sample, view) if (name := line.split(".")[0]) in tools
    ]
    lazy, relation, frame = opened
    assert lazy.collect().height == count
    assert relation.aggregate("count(*)").fetchall() == [(count,)]
    assert len(frame) == count
    assert set(lazy.collect()["split"]) == set(frame["split"])
    assert list(frame.columns) == [*(column.name for column in VIEWS[view]), "split"]


@pytest.fixture
def datasets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Hugging Face `datasets` without network, with its cache in a folder of the test."""
    for name in (
        "HF_HUB_OFFLINE",
        "HF_DATASETS_OFFLINE",
        "HF_HUB_DISABLE_TELEMETRY",
        "HF_DATASETS_DISABLE_PROGRESS_BARS",
    ):
        monkeypatch.setenv(name, "1")
    module: ModuleType = pytest.importorskip("datasets")
    monkeypatch.setattr(module.config, "HF_DATASETS_CACHE", tmp_path / "cache")
    return module


@pytest.mark.parametrize(
    "view", ["episodes", *(pytest.param(view, marks=pytest.mark.slow) for view in VIEWS if view != "episodes")]
)
def test_hugging_face_datasets_opens_each_view_with_its_splits(
    sample: Sample, view: str, datasets: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(sample.folder.parent)
    found = eval(open_lines(sample, view)[3], {"datasets": datasets})
    expected = {path.name.removeprefix("split="): pq.read_table(path) for path in Path(f"sample/view={view}").iterdir()}
    assert {split: rows.num_rows for split, rows in found.items()} == {name: t.num_rows for name, t in expected.items()}
    for split, table in expected.items():
        assert found[split].column_names == [column.name for column in VIEWS[view]]
        assert found[split].with_format("arrow")[:].to_pylist() == table.select(found[split].column_names).to_pylist()


def test_hugging_face_datasets_opens_the_table_of_runs(sample: Sample, datasets: ModuleType) -> None:
    found = datasets.load_dataset(str(sample.folder), "runs", split="runs")
    assert set(found["run"]) == {member.run for member in sample.members}


def test_a_split_without_rows_of_a_view_has_no_file(sample: Sample, tmp_path: Path, datasets: ModuleType) -> None:
    quiet = [replace(one, split="test") for one in sample.members if one.run == "drop.nominal"]
    others = [one for one in sample.members if one.block == "mode"]
    folder = build_dataset([*quiet, *others], tmp_path / "set", "set", license_url="https://example.org/licence")
    assert [path.name for path in (folder / "view=episodes").iterdir()] == ["split=train"]
    assert set(datasets.load_dataset(str(folder), "episodes")) == {"train"}
    header = yaml_header(folder)
    assert 'license: other\nlicense_link: "https://example.org/licence"' in header
    assert header.count("path: view=episodes/") == 1


def yaml_header(folder: Path) -> str:
    return (folder / "README.md").read_text().split("---\n")[1]


def test_croissant_1_1_is_valid_and_reads_records(sample: Sample) -> None:
    mlcroissant = pytest.importorskip("mlcroissant")
    value = json.loads((sample.folder / "croissant.json").read_text())
    assert value["conformsTo"] == list(CONFORMS_TO)
    assert "rai:dataLimitations" in value
    described = mlcroissant.Dataset(jsonld=str(sample.folder / "croissant.json"))  # raises for what does not conform
    assert not described.metadata.issues.warnings
    record = next(iter(described.records("flows")))
    assert record["flows/frames"] > 0
    assert record["flows/split"] in (b"train", b"test", b"heldout_family")


def test_a_run_flies_again_from_what_is_stored(sample: Sample, tmp_path: Path) -> None:
    stored = json.loads((sample.folder / "regenerate.json").read_text())
    run = stored["runs"]["mode.attacked"]
    again = fly(load_text(stored["scenarios"][run["scenario"]]), tmp_path / "again", report=False)
    assert again.manifest["digests"]["fingerprint"] == run["fingerprint"]
    assert run["versions"]["skyrange"]


def test_the_files_do_not_depend_on_the_order_of_members(sample: Sample, tmp_path: Path) -> None:
    again = build_dataset(sample.members, tmp_path / "again", "sample", settings=BOTH)
    assert (again / "SHA256SUMS").read_text() == (sample.folder / "SHA256SUMS").read_text()


class StoppedError(Exception):
    """Ends a build in the middle of a block."""


def stop_build(runs: Path, out: Path) -> None:
    """Build the data set until the second view of a run, in this process."""

    def views(record: RunRecord, *rest: Any) -> Any:
        for number, found in enumerate(run_views(record, *rest)):
            if record.path.name == "mode-nominal" and number == 1:
                raise StoppedError
            yield found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "run_views", views)
        with pytest.raises(StoppedError):
            build_dataset(read_members(runs), out, "sample", settings=BOTH)


def kill_build(runs: Path, out: Path) -> None:
    """Build the data set until the second view of a run, in a process that is killed then."""
    begun = f"""
import os, signal
from pathlib import Path
from skyrange.dataset import build
from tests.integration.test_dataset import BOTH, read_members
views = build.run_views
def killed(record, *rest):
    for number, found in enumerate(views(record, *rest)):
        if record.path.name == "mode-nominal" and number == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        yield found
build.run_views = killed
build.build_dataset(read_members({str(runs)!r}), Path({str(out)!r}), "sample", settings=BOTH)
"""
    ended = subprocess.run([sys.executable, "-c", begun], cwd=Path(__file__).parents[2], check=False)
    assert ended.returncode == -signal.SIGKILL


@pytest.mark.parametrize("interrupt", [stop_build, pytest.param(kill_build, marks=pytest.mark.slow)])
def test_an_interrupted_build_goes_on_without_the_blocks_that_are_whole(
    sample: Sample, interrupt: Callable[[Path, Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "again"
    rows = [
        {
            **{name: getattr(one, name) for name in ("block", "arm", "split", "seed", "factors")},
            "folder": str(one.record),
            "effects_s": {name: "never" if at is None else at for name, at in (one.effects_s or {}).items()},
        }
        for one in sample.members
    ]
    (tmp_path / "runs.json").write_text(json.dumps({"runs": rows}))
    members = read_members(tmp_path / "runs.json")
    interrupt(tmp_path / "runs.json", out)
    assert {path.name for path in out.glob("view=*/split=*/*.parquet")} == {"drift.parquet", "drop.parquet"}
    assert not (out / "README.md").exists()
    assert not (out / "SHA256SUMS").exists()
    with pytest.raises(InputError, match="not finished"):
        read_arms(out)
    with pytest.raises(InputError, match="other runs or settings"):
        build_dataset(members, out, "another")
    written = []

    def count(record: RunRecord, *rest: Any) -> Any:
        written.append(record.path.name)
        return run_views(record, *rest)

    monkeypatch.setattr(build, "run_views", count)
    build_dataset(members, out, "sample", settings=BOTH)
    assert written == ["mode-nominal", "mode-attacked", "mode-sham"]
    assert (out / "SHA256SUMS").read_text() == (sample.folder / "SHA256SUMS").read_text()
    assert {path.name for path in out.iterdir()} == {path.name for path in sample.folder.iterdir()}
    with pytest.raises(InputError, match="new or empty"):
        build_dataset(members, out, "sample", settings=BOTH)


def test_one_process_builds_a_data_set(tmp_path: Path) -> None:
    with (
        begin_build(tmp_path / "set", {}),
        pytest.raises(InputError, match="being built"),
        begin_build(tmp_path / "set", {}),
    ):
        pass
    assert list((tmp_path / "set").iterdir()) == []


def test_altered_files_are_named(sample: Sample, tmp_path: Path) -> None:
    copy = shutil.copytree(sample.folder, tmp_path / "copy")

    def check() -> subprocess.CompletedProcess[str]:
        command = ["env", "LC_ALL=C", "sha256sum", "--check", "--quiet", "--strict", "SHA256SUMS"]
        return subprocess.run(command, cwd=copy, check=False, capture_output=True, text=True)

    assert check().returncode == 0
    listed = {line.split("  ", 1)[1] for line in (copy / "SHA256SUMS").read_text().splitlines()}
    there = {path.relative_to(copy).as_posix() for path in copy.rglob("*") if path.is_file()}
    assert there - listed == {"SHA256SUMS"}
    (copy / "README.md").write_text("other")
    (copy / "runs.parquet").unlink()
    ended = check()
    assert ended.returncode == 1
    assert sorted(ended.stdout.splitlines()) == ["README.md: FAILED", "runs.parquet: FAILED open or read"]


@pytest.mark.parametrize(
    ("table", "column"), [("frames", "dst"), ("truth", "east_m"), ("labels", "actor"), ("received_sensors", "gnss_fix")]
)
def test_a_run_whose_tables_were_altered_is_refused_before_anything_is_written(
    sample: Sample, tmp_path: Path, table: str, column: str
) -> None:
    member = next(one for one in sample.members if one.run == "drift.attacked")
    received = member.record / "received_sensors.parquet"
    assert pq.read_table(received).column("time_ns")[0].as_py() >= ONSET_NS  # the drift is in it, and nothing before
    copy = Path(shutil.copytree(member.record, tmp_path / "copy"))
    file = copy / f"{table}.parquet"
    kept = pq.read_table(file)
    values = kept.column(column).to_pylist()
    values[-1] = f"{values[-1]}x" if isinstance(values[-1], str) else values[-1] + 1
    place = kept.column_names.index(column)
    pq.write_table(kept.set_column(place, kept.field(place), pa.array(values, kept.field(place).type)), file)
    members = [replace(member, record=copy) if one is member else one for one in sample.members]
    with pytest.raises(InputError, match=rf"(?s)dataset altered: .*copy: {table}.*skyrange verify"):
        build_dataset(members, tmp_path / "out", "altered")
    assert not (tmp_path / "out").exists()


def test_members_are_read_from_a_file(sample: Sample, tmp_path: Path) -> None:
    table = {"folder": str(sample.members[0].record), "block": "b", "arm": "nominal", "effects_s": {"blue/b1": "never"}}
    (tmp_path / "runs.json").write_text(json.dumps({"runs": [table]}))
    (member,) = read_members(tmp_path / "runs.json")
    assert (member.seed, member.effects_s) == (3, {"blue/b1": None})
    (tmp_path / "runs.toml").write_text('[[runs]]\nfolder = "nowhere"\nblock = "b"\narm = "nominal"\ncolour = 3\n')
    with pytest.raises(InputError, match="colour"):
        read_members(tmp_path / "runs.toml")


@pytest.mark.parametrize("split", ["", "validation", "../x", "all"])
def test_a_block_lies_in_one_split(sample: Sample, tmp_path: Path, split: str) -> None:
    first, *others = sample.members
    given = [replace(first, split=split), *others]
    if split in ("../x", "all"):
        given = [replace(member, split=split) for member in sample.members]
    with pytest.raises(InputError, match=f"block {'mode' if split in ('', 'validation') else 'drift: split'}"):
        build_dataset(given, tmp_path / "x", "x")
    assert not (tmp_path / "x").exists()
