"""Detectors in a study: their scores, and the data set of its runs, by the commands that a user types."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.contracts.monitors import MonitorPlacement
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.detect.learned.model_file import read_model, write_model
from skyrange.detect.learned.windows import LearnedWindows
from skyrange.record import load, replay_monitor
from skyrange.scenario.model.defences import DetectorTable
from skyrange.scenario.toml_files import load_file
from skyrange.scoring.result_file import read_scores
from skyrange.study.design.blocks import check_blocks, city_of, list_blocks, scenario_in
from skyrange.study.design.model import SHIPPED, read_study
from skyrange.study.execution.worker import fly_group
from skyrange.study.folder import open_folder
from skyrange.study.learned_detectors import learn_detectors
from skyrange.study.runs import fly
from skyrange.study.score_tables import make_score_tables
from skyrange.study.study_run import StudyPlan
from tests.flights import shared_folder

pytestmark = pytest.mark.slow

STREETS = Path(__file__).parents[3] / "shared/data/cities/manhattan-upper-east-side.geojson"
TEXT = """
name = "small"
keep = "everything"
scenario = "gnss.jump"
changes = ["duration_s=24", "operators.*.streams=operator"]
seeds = 2
arms = ["nominal", "attacked"]

[[draws]]
name = "onset"
key = "attacks.jump.start_s"
low = 9
high = 12

[[detectors]]
id = "gnss"
kind = "navigation.gnss_innovation"

[[detectors]]
id = "gap"
kind = "heartbeat.gap"

[learned]
window_s = 0.5
"""


LEARNED = ("isolation-forest", "gradient-boosting")


def command(*words: str) -> Any:
    result = CliRunner().invoke(app, list(words))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return json.loads(result.stdout) if "--json" in words else result.stdout


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of six blocks; a copy, because scores and models are written into it."""

    def fly_all(folder: Path) -> None:
        file = folder.with_suffix(".toml")
        file.write_text(TEXT)
        changes = ("--set", "seeds=6", "--set", "held_out.aircraft=[2]")
        found = command("study", "run", str(file), "--out", str(folder), *changes, "--json")
        assert (found["finished"], found["failed"]) == (6, [])

    flown = shared_folder("study-of-detectors", fly_all)
    return Path(shutil.copytree(flown, tmp_path_factory.mktemp("study") / "out"))


@pytest.mark.slow
def test_a_detector_that_sees_the_attack_leads_one_that_does_not(study: Path, tmp_path: Path) -> None:
    file = tmp_path / "scores.json"
    command("study", "score", str(study), "--out", str(file), "--json")
    scores = {one.detector: one.sets[0] for one in read_scores(file).detectors}
    assert set(scores) == {"gnss", "gap", "always", "never", "by-time", *LEARNED}
    gnss, gap = scores["gnss"].detection, scores["gap"].detection
    assert gnss is not None
    assert gap is not None
    assert gnss.recall is not None
    assert gap.recall is not None
    assert gnss.recall.value == 1.0
    assert gap.recall.value == 0.0
    board = command("study", "score", str(study), "--beside", str(file))
    assert board.index("gnss") < board.index("gap")
    assert (study / "scores.json").is_file()


def test_models_are_trained_on_the_training_blocks_and_described(study: Path) -> None:
    command("study", "score", str(study))
    scores = {one.detector: one for one in read_scores(study / "scores.json").detectors}
    for name in LEARNED:
        model = read_model(study / "models" / f"{name}.json")
        threshold = scores[name].threshold
        assert threshold is not None
        assert model.threshold == threshold.value
        assert model.training["blocks"] < 6
        card = (study / "models" / f"{name}.md").read_text()
        assert card.startswith(f"# Model card: {name}\n")
        assert ("- kinds of attack: gnss.jump" in card) == (name == "gradient-boosting")
        assert "## Limits" in card
    recall = scores["gradient-boosting"].sets[0].detection.recall
    assert recall is not None
    assert recall.value == 1.0


@pytest.mark.parametrize("name", LEARNED)
def test_a_trained_model_alerts_in_a_run_and_over_a_record_as_in_the_scores(
    study: Path, tmp_path: Path, name: str
) -> None:
    folder = open_folder(study)
    learned = learn_detectors(folder, make_score_tables(folder))
    block = folder.blocks[0]
    mine = [
        row for row in learned.alerts.to_pylist() if (row["detector"], row["run"]) == (name, f"{block.name}.attacked")
    ]
    threshold = sorted(row["score"] for row in mine)[len(mine) // 2]
    file = tmp_path / "model.json"
    write_model(learned.models[name].model_copy(update={"threshold": threshold}), file)
    scored = [
        (round(row["time_s"] * NS_PER_S), row["subject"], row["score"] / threshold)
        for row in mine
        if row["score"] > threshold
    ]
    assert len(scored) > len(mine) // 4
    scenario = scenario_in(folder.study, folder.study.arms[1], block)
    table = DetectorTable(id="live", kind="learned.windows", params={"file": str(file)})
    again = fly(scenario.model_copy(update={"detectors": (table,)}), tmp_path / "again", report=False)
    flown = load(study / "runs" / block.name / "attacked")
    assert again.manifest["digests"]["fingerprint"] == flown.manifest["digests"]["fingerprint"]
    live = [(row["time_ns"], row["subject"], row["score"]) for row in again.table("alerts").to_pylist()]  # in a run
    copied = load_file(again.path / "scenario.toml").detectors[0].params["file"]
    assert copied == str(again.path.absolute() / "given/1-model.json")  # the folder repeats the run
    assert Path(copied).read_bytes() == file.read_bytes()
    make = partial(LearnedWindows.plugin, table.settings, None)  # it reads nothing of the context
    placement = MonitorPlacement("later", make, ["gcs:*"], "gcs")
    replayed = [(one.alert.at, one.alert.subject, one.alert.score) for one in replay_monitor(flown, placement)]
    assert live == replayed
    assert [one[:2] for one in live] == [one[:2] for one in scored]
    assert [one[2] for one in live] == pytest.approx([one[2] for one in scored], rel=1e-12)


def test_a_run_whose_windows_are_missing_is_flown_again(study: Path, tmp_path: Path) -> None:
    folder = open_folder(study)
    block = folder.blocks[0]
    shutil.copytree(study / "runs" / block.name, tmp_path / "runs" / block.name)
    (tmp_path / "blocks").mkdir()
    (tmp_path / "runs" / block.name / "nominal" / "windows.parquet").unlink()
    kept = tmp_path / "runs" / block.name / "attacked" / "manifest.json"
    before = kept.stat().st_mtime_ns
    plan = StudyPlan(folder.study, [block])
    fly_group(plan, tmp_path, plan.blocks)
    for arm in ("nominal", "attacked"):
        mine, theirs = (path / "kept" / "windows" / block.name / f"{arm}.parquet" for path in (tmp_path, study))
        assert mine.read_bytes() == theirs.read_bytes()
    assert kept.stat().st_mtime_ns == before


def test_windows_that_are_gone_are_named(study: Path, tmp_path: Path) -> None:
    shutil.copytree(study, tmp_path / "copy")
    shutil.rmtree(tmp_path / "copy" / "kept" / "windows" / open_folder(study).blocks[2].name)
    with pytest.raises(InputError, match=r"windows.*resume the study"):
        command("study", "score", str(tmp_path / "copy"))


def test_a_detector_and_a_learned_one_have_different_names(tmp_path: Path) -> None:
    for name in ("isolation-forest", "windows"):
        (tmp_path / "study.toml").write_text(TEXT.replace('id = "gap"', f'id = "{name}"'))
        study = read_study(tmp_path / "study.toml")
        with pytest.raises(InputError, match=f"{name}.*an id that no learned detector has"):
            check_blocks(study, list_blocks(study))


def test_the_runs_make_a_data_set_whose_blocks_lie_in_one_split(study: Path, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    made = command("dataset", "build", str(study), str(tmp_path / "data"), "--json")
    assert made["runs"] == 12
    runs = pq.read_table(tmp_path / "data" / "runs.parquet").to_pylist()
    assert len({(row["block"], row["split"]) for row in runs}) == 6
    assert (tmp_path / "data" / "croissant.json").is_file()
    found = command("dataset", "audit", str(tmp_path / "data"), "--json")
    assert {one["status"] for one in found} == {"passed"}, (
        "arms are equal to the byte up to the onset, in six blocks or more"
    )


def test_options_replace_what_a_study_holds_out(study: Path, tmp_path: Path) -> None:
    made = command("dataset", "build", str(study), str(tmp_path / "held"), "--hold-out-fleet", "1", "--json")
    assert made["splits"] == {"heldout_fleet": 12}
    with pytest.raises(InputError, match="training blocks"):
        command("study", "score", str(study), "--hold-out-fleet", "1")
    with pytest.raises(InputError, match="gnss_false_position"):
        command("study", "score", str(study), "--hold-out-family", "gnss_false_positions")
    with pytest.raises(InputError, match="one of 1"):
        command("dataset", "build", str(study), str(tmp_path / "none"), "--hold-out-fleet", "7")
    assert not (tmp_path / "none").exists()


def test_a_data_set_has_the_splits_of_the_file(study: Path, tmp_path: Path) -> None:
    other = tmp_path / "study"
    shutil.copytree(study, other)
    data = json.loads((other / "plan.json").read_text())
    data["told"]["held_out"]["families"] = ["gnss_false_position"]
    (other / "plan.json").write_text(json.dumps(data))
    made = command("dataset", "build", str(other), str(tmp_path / "data"), "--json")
    assert made["splits"] == {"heldout_family": 12}


def test_a_study_without_whole_runs_makes_no_data_set(study: Path, tmp_path: Path) -> None:
    text = (study / "plan.json").read_text().replace('"keep": "everything"', '"keep": "results"')
    (tmp_path / "blocks").mkdir()
    (tmp_path / "plan.json").write_text(text)
    with pytest.raises(InputError, match="everything"):
        command("dataset", "build", str(tmp_path), str(tmp_path / "data"))


@pytest.mark.parametrize("name", sorted(SHIPPED))
def test_scenarios_of_the_shipped_studies_are_right(name: str) -> None:
    study = read_study(name)
    check_blocks(study, list_blocks(study)[::12])


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SHIPPED))
def test_all_scenarios_of_the_shipped_studies_are_right(name: str) -> None:
    study = read_study(name)
    check_blocks(study, list_blocks(study))


@pytest.mark.slow
@pytest.mark.skipif(not STREETS.exists(), reason="the Manhattan extract is not beside the project")
def test_the_shipped_study_can_be_flown_over_a_real_city() -> None:
    changes = [
        f"draws.city.values=['downtown-1', '{STREETS}']", f"held_out.cities=['{STREETS.name}']",
        "factors.condition.values=['gnss.jam']", "draws.fleet.values=[6]",
    ]  # fmt: skip
    study = read_study("detectors", changes)
    blocks = list_blocks(study)
    assert {city_of(study, block) for block in blocks} == {"downtown-1", STREETS.name}
    check_blocks(study, blocks[:1] + [block for block in blocks if city_of(study, block) == STREETS.name][:1])
