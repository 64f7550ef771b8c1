"""Files that skyrange writes or that users write for it, made once, and the commands and loaders that read each."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple
from unittest.mock import patch

import typer

from skyrange.analysis import load, load_pair
from skyrange.assembly.build import build
from skyrange.assembly.city import build_city
from skyrange.city.building_files import load_buildings
from skyrange.cli.app import app
from skyrange.dataset.audit.comparisons import comparisons_of, find_crossings
from skyrange.dataset.build import build_dataset
from skyrange.dataset.members import Member, assign_splits, check_held_out, check_splits, cluster_members, read_members
from skyrange.dataset.progress import BuildProgress, RowCounts
from skyrange.detect.learned.model_file import Model, read_model
from skyrange.radio.propagation.loss_table_file import read_loss_table
from skyrange.radio_map.mapping import MapLayout
from skyrange.runtime.run import Run
from skyrange.scenario.shipped import load as load_scenario
from skyrange.scoring.leaderboard import rank_detectors
from skyrange.scoring.result_file import read_scores
from skyrange.scoring.scores import score_detectors
from skyrange.study.dataset_members import list_dataset_members
from skyrange.study.design.blocks import check_blocks, list_blocks
from skyrange.study.design.model import read_study
from skyrange.study.execution.executors import InThisProcess
from skyrange.study.execution.store import open_store
from skyrange.study.folder import open_folder, require_unchanged
from skyrange.study.learned_detectors import learn_detectors
from skyrange.study.matrix.flights import fly_matrix, plan_matrix
from skyrange.study.matrix.model import read_matrix
from skyrange.study.pairing import pair
from skyrange.study.registration import read_registration, register_study
from skyrange.study.score_tables import make_score_tables
from skyrange.study.shown_runs import choose_runs
from skyrange.study.study_run import run_study
from skyrange.study.variants import compare_variants, open_plan
from skyrange.view.folders import read_folder_arms
from tests.loss_tables import make_table
from tests.unit.score_sample import alert, attack, flight, tables
from tests.unit.test_learned_detectors import model_of

SCENARIO: Final = """
name = "small"
seed = 3
duration_s = 4
origin = { lat = 40.7780, lon = -73.9550 }
city.buildings = "city.geojson"

[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan = { path = { points = [[0, 0], [0, 20]], alt_m = 5 }, speed_mps = 5, end = "land" }

[[attacks]]
id = "mallory"
start_s = 1
kind = "link.drop"
params = { links = ["gcs:blue/b1"], direction = "rev", probability = 0.5 }
"""
STUDY: Final = """
name = "small-study"
scenario = "small.toml"
keep = "everything"
factors = [{ name = "p", key = "attacks.mallory.params.probability", values = [0.2, 0.5] }]
draws = [{ name = "speed", key = "operators.*.vehicles.*.plan.speed_mps", low = 4.0, high = 6.0 }]
arms = [{ id = "nominal", attacks = "muted" }, { id = "attacked", attacks = "active" }]
registration = { question = "Does it?", measures = ["departure_m"], rule = "t" }
held_out = { cities = ["elsewhere"] }
"""
LEARNING: Final = """
name = "learning"
scenario = "small.toml"
seeds = 3
arms = [{ id = "nominal", attacks = "muted" }, { id = "attacked", attacks = "active" }]
changes = ["duration_s=40"]
learned = { algorithms = ["isolation_forest"], window_s = 0.5 }
"""
MISSION: Final = """
name = "mission"
duration_s = 20
origin = { lat = -35.3633280, lon = 149.1652241 }

[[operators]]
id = "blue"
vehicles = [{ id = "b1", plan = { file = "FILE" } }]
"""
MATRIX: Final = """
name = "small-matrix"
seeds = 1

[[rows]]
id = "drop"
scenario = "small.toml"
measure = "departure_m"

[[columns]]
id = "firewall"
defences = [{ kind = "mavlink.firewall" }]
"""
CITY: Final[dict[str, Any]] = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"height": 12.5, "name": "block"},
            "geometry": {"type": "Polygon", "coordinates": [[
                [-73.9545, 40.7781], [-73.9543, 40.7781], [-73.9543, 40.7783], [-73.9545, 40.7783], [-73.9545, 40.7781],
            ]]},
        }
    ],
}  # fmt: skip
LOAD: Final = {
    "wall_s": 1.0, "cpu_s": 1.0, "involuntary_switches": 0, "loadavg_before": 0.1, "loadavg_after": 0.1,
    "elsewhere_cores": None, "yardstick_before_us": 8.0, "yardstick_after_us": 8.0,
}  # fmt: skip
MEASURE: Final = {"name": "sums", "unit": "1/s", "better": "higher", "relative": False, "value": 1000.0}
CASE: Final = {
    "name": "10 numbers", "load": LOAD, "rows": [{"name": "", "measures": [MEASURE], "data": {"sums": 1}}],
    "memory": {"every_s": 0.25, "resident_mb": [20.0], "peak_mb": 20.0, "processes": 1},
}  # fmt: skip
BENCHMARKS: Final = {
    "format": "skyrange.bench", "version": 1, "skyrange": "0.1.0", "started": "2026-01-01T12:00:00Z", "quick": True,
    "machine": {"processor": "one", "cores": 2, "memory_mb": None, "virtual": True, "system": "Linux",
                "python": "3.11", "numpy": "2", "numba": "0", "llvmlite": "0"},
    "benchmarks": [{"name": "sums", "about": "Sums of numbers.", "cases": [CASE]}],
}  # fmt: skip


def make_files(folder: Path) -> None:
    """Write every kind of file into a folder: some short flights, what is made of them, and files without a flight."""
    folder.mkdir(parents=True)
    (folder / "city.geojson").write_text(json.dumps(CITY))
    (folder / "small.toml").write_text(SCENARIO)
    (folder / "study.toml").write_text(STUDY)
    (folder / "matrix.toml").write_text(MATRIX)
    (folder / "learning.toml").write_text(LEARNING)
    study, scenario = read_study(folder / "study.toml"), load_scenario(str(folder / "small.toml"))
    register_study(study, folder / "study")
    run_study(study, folder / "study", executor=InThisProcess())
    pair(scenario, folder / "pair", jobs=1, run_reports=False)
    compare_variants(str(folder / "small.toml"), {"short": ["duration_s=3"]}, folder / "comparison", jobs=1)
    with contextlib.chdir(folder):
        fly_matrix(read_matrix("matrix.toml"), folder / "matrix", jobs=1)
    members = assign_splits(list_dataset_members(folder / "study"), 1)
    build_dataset(members, folder / "data", "data")
    rows = [
        {"folder": str(member.record.relative_to(folder)), "block": member.block, "arm": member.arm,
         "split": member.split, "factors": dict(member.factors), "seed": member.seed,
         "effects_s": {"blue/b1": 1.5, "blue/b2": "never"}}
        for member in members
    ]  # fmt: skip
    (folder / "members.json").write_text(json.dumps({"runs": rows}))
    _make_interrupted_build(members, folder / "half")
    _make_missions(folder)
    learning = read_study(folder / "learning.toml")
    run_study(learning, folder / "learning", executor=InThisProcess())
    killed = Run.start(scenario, folder / "killed")
    killed.advance(3)
    killed.recorder.flush()  # as a killed process leaves it: it is never finished
    city = build_city(scenario)
    assert city is not None
    make_table(folder / "losses.parquet", city, MapLayout((-60.0, -60.0, 60.0, 60.0), 30.0, (2.0, 20.0), 200.0))
    (folder / "model.json").write_text(model_of("isolation_forest").model_dump_json())
    scored = tables(
        [flight("v", split="validation"), flight("a"), flight("b", arm="attacked")], [attack("b")], [alert("b", 1020.0)]
    )
    (folder / "scores.json").write_text(score_detectors(scored, None, ["d"], "small").model_dump_json())
    (folder / "benchmarks.json").write_text(json.dumps(BENCHMARKS))


def _make_interrupted_build(members: Sequence[Member], folder: Path) -> None:
    """A data set of which one block is whole."""
    finish = BuildProgress.finish_block

    def finish_and_end(progress: BuildProgress, block: str, rows: RowCounts) -> None:
        finish(progress, block, rows)
        raise KeyboardInterrupt

    with patch.object(BuildProgress, "finish_block", finish_and_end), contextlib.suppress(KeyboardInterrupt):
        build_dataset(members, folder, "half")


def _make_missions(folder: Path) -> None:
    for name in ("survey.plan", "square.waypoints"):
        shutil.copy(Path(__file__).parent / "data" / "missions" / name, folder / name)
        (folder / f"{name}.toml").write_text(MISSION.replace("FILE", name))


class WrittenFile(NamedTuple):
    """A file, and what reads it."""

    path: str
    """Relative to the folder that `make_files` filled."""
    read: Sequence[Sequence[str] | Callable[[Path], object]]
    """Commands, whose words that begin with @ are paths in the folder, and loaders, which get the folder."""


def call(reader: Sequence[str] | Callable[[Path], object], folder: Path) -> None:
    """Have a command or a loader read what is in a folder. Raises what it raises."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        if callable(reader):
            reader(folder)
            return
        words = [str(folder / word[1:]) if word.startswith("@") else word for word in reader]
        with contextlib.suppress(typer.Exit, SystemExit):
            app(words, prog_name="skyrange", standalone_mode=False)


def _read_plan(folder: Path) -> None:
    opened = open_folder(folder / "study")
    require_unchanged(opened)


def _open_comparison(folder: Path) -> None:
    plan = open_plan(open_store(folder / "comparison"))
    plan.digest()


def _build_members(folder: Path) -> None:
    members = read_members(folder / "members.json")
    cluster_members(members)
    check_splits(members)
    check_held_out(members)


def _audit(folder: Path) -> None:
    for _ in comparisons_of(folder / "data", ()):
        pass
    find_crossings(folder / "data")


def _plan_matrix(folder: Path) -> None:
    with contextlib.chdir(folder):
        plan_matrix(read_matrix("matrix.toml"), "results")


def _check_study(folder: Path) -> None:
    study = read_study(folder / "study.toml")
    check_blocks(study, list_blocks(study))


def _finish_build(folder: Path) -> None:
    copy = folder / "half-copy"
    shutil.copytree(folder / "half", copy)
    try:
        build_dataset(assign_splits(list_dataset_members(folder / "study"), 1), copy, "half")
    finally:
        shutil.rmtree(copy)


def _learn(folder: Path) -> None:
    opened = open_folder(folder / "learning")
    learn_detectors(opened, make_score_tables(opened))


def _check_mission(name: str) -> Callable[[Path], object]:
    return lambda folder: build(load_scenario(str(folder / f"{name}.toml")))


_STUDY: Final = (
    ("study", "status", "@study"), ("study", "status", "@study", "--json"), ("study", "show", "@study"),
    ("study", "report", "@study"), _read_plan,
    lambda folder: make_score_tables(open_folder(folder / "study")),
    lambda folder: list_dataset_members(folder / "study"),
    lambda folder: [run.kept for run in choose_runs(folder / "study", None, None).runs],
)  # fmt: skip
_PAIR: Final = (
    ("show", "@pair"), ("show", "@pair", "--json"), ("report", "@pair"),
    lambda folder: load_pair(folder / "pair").failed_missions,
    lambda folder: read_folder_arms(folder / "pair", None),
)  # fmt: skip
_RUN: Final = (
    ("show", "@pair/attacked"), ("show", "@pair/attacked", "--json"), ("report", "@pair/attacked"),
    ("diff", "@pair/attacked", "@pair/nominal"), ("diff", "@pair/attacked", "@pair/nominal", "--tolerance", "1"),
    ("export", "@pair/attacked"), ("export", "@pair/attacked", "--csv", "--tlog", "--mcap", "--kml", "--tables"),
    lambda folder: read_folder_arms(folder / "pair" / "attacked", None).encode(),
)  # fmt: skip
_KILLED: Final = (
    ("show", "@killed"), ("show", "@killed", "--json"), ("report", "@killed"),
    ("diff", "@killed", "@pair/nominal"), ("export", "@killed", "--csv", "--mcap"),
    lambda folder: _read_all(folder / "killed"),
    lambda folder: read_folder_arms(folder / "killed", None).encode(),
)  # fmt: skip
_BLOCKS: Final = "p0000-s1"

FILES: Final[dict[str, WrittenFile]] = {
    "study file": WrittenFile("study.toml", (_check_study,)),
    "matrix file": WrittenFile("matrix.toml", (_plan_matrix,)),
    "scenario": WrittenFile("small.toml", (lambda folder: load_scenario(str(folder / "small.toml")),)),
    "city": WrittenFile("city.geojson", (lambda folder: load_buildings(folder / "city.geojson"),)),
    "plan of a study": WrittenFile("study/plan.json", _STUDY),
    "block of a study": WrittenFile(f"study/blocks/{_BLOCKS}.json", _STUDY),
    "registration": WrittenFile(
        "study/registration.json",
        (("study", "report", "@study"), lambda folder: read_registration(open_folder(folder / "study"))),
    ),
    "plan of a comparison": WrittenFile(
        "comparison/plan.json", (_open_comparison, lambda folder: choose_runs(folder / "comparison", None, None))
    ),
    "block of a comparison": WrittenFile("comparison/blocks/seed-3/short.json", (("resume", "@comparison"),)),
    "plan of a matrix": WrittenFile("matrix/plan.json", (lambda folder: choose_runs(folder / "matrix", None, None),)),
    "block of a matrix": WrittenFile("matrix/blocks/drop/none/seed-3.json", (("resume", "@matrix", "--jobs", "1"),)),
    "plan of a pair": WrittenFile("pair/plan.json", (("resume", "@pair", "--jobs", "1"),)),
    "manifest of a pair": WrittenFile("pair/pair.json", _PAIR),
    "effects of a pair": WrittenFile("pair/effects.parquet", _PAIR),
    "attribution of a pair": WrittenFile("pair/attribution.parquet", _PAIR),
    "propagation of a pair": WrittenFile("pair/propagation.parquet", _PAIR),
    "manifest of a run": WrittenFile("pair/attacked/manifest.json", (*_RUN, ("verify", "@pair/attacked"))),
    "manifest of a run of a pair": WrittenFile("pair/attacked/manifest.json", _PAIR),
    "buildings of a run": WrittenFile("pair/attacked/city.json", _RUN),
    "scenario of a run": WrittenFile("pair/attacked/scenario.toml", _RUN),
    **{
        f"{table} of a run": WrittenFile(f"pair/attacked/{table}.parquet", _RUN)
        for table in ("truth", "frames", "payloads", "events", "decisions", "labels", "sensors", "receptions")
    },
    "telemetry of a run": WrittenFile("pair/attacked/telemetry/HEARTBEAT.parquet", _RUN),
    "members of a data set": WrittenFile("members.json", (_build_members,)),
    "runs of a data set": WrittenFile("data/runs.parquet", (_audit,)),
    **{
        f"{view} of a data set": WrittenFile(f"data/view={view}/split=SPLIT/{_BLOCKS}.parquet", (_audit,))
        for view in ("mavlink", "flows", "aircraft", "episodes")
    },
    "progress of a data set": WrittenFile("half/.building/plan.json", (_finish_build,)),
    "block of a data set": WrittenFile(f"half/.building/blocks/{_BLOCKS}.json", (_finish_build,)),
    "windows of a study": WrittenFile(f"learning/kept/windows/{_BLOCKS}/nominal.parquet", (_learn,)),
    "loss table": WrittenFile("losses.parquet", (lambda folder: read_loss_table(folder / "losses.parquet").table,)),
    "plan of QGroundControl": WrittenFile("survey.plan", (_check_mission("survey.plan"),)),
    "list of waypoints": WrittenFile("square.waypoints", (_check_mission("square.waypoints"),)),
    "manifest of a killed run": WrittenFile("killed/manifest.json", _KILLED),
    **{
        f"{table} of a killed run": WrittenFile(f"killed/.spool/{table}-0000.arrows", _KILLED)
        for table in ("truth", "frames", "payloads", "events", "labels")
    },
    "model": WrittenFile("model.json", (lambda folder: Model(read_model(folder / "model.json")),)),
    "scores": WrittenFile("scores.json", (lambda folder: rank_detectors([read_scores(folder / "scores.json")]),)),
    "benchmarks": WrittenFile("benchmarks.json", (("bench", "page", "@benchmarks.json"),)),
    "record": WrittenFile("pair/attacked/manifest.json", (lambda folder: _read_all(folder / "pair" / "attacked"),)),
}
"""By what it is."""


def _read_all(folder: Path) -> None:
    record = load(folder)
    assert record.status
    assert record.duration >= 0.0
    for name in ("truth", "frames", "events", "features", "observations"):
        record.table(name)
    record.rows("frames")
    list(record.frames_with_payloads())
    for message in record.messages:
        record.telemetry(message) if message != "BAD_DATA" else None
    record.outcomes  # noqa: B018
    record.city  # noqa: B018
