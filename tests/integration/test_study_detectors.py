"""Detectors in a study: their scores, and the data set of its runs, by the commands that a user types."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.core.errors import InputError
from skyrange.study.scoring.result_file import read_scores
from skyrange.study.sweep.blocks import check_blocks, city_of, list_blocks
from skyrange.study.sweep.model import SHIPPED, read_study

STREETS = Path(__file__).parents[3] / "shared/data/cities/manhattan-upper-east-side.geojson"
TEXT = """
name = "small"
keep = "everything"
scenario = "gnss.jump"
changes = ["duration_s=36", "operators.*.streams=operator"]
seeds = 2
arms = ["nominal", "attacked"]

[[draws]]
name = "onset"
key = "attacks.jump.start_s"
low = 14
high = 18

[[detectors]]
id = "gnss"
kind = "navigation.gnss_innovation"

[[detectors]]
id = "gap"
kind = "heartbeat.gap"
"""


def command(*words: str) -> Any:
    result = CliRunner().invoke(app, list(words))
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return json.loads(result.stdout) if "--json" in words else result.stdout


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    (folder / "small.toml").write_text(TEXT)
    changes = ("--set", "seeds=6", "--set", "held_out.aircraft=[2]")
    found = command("study", "run", str(folder / "small.toml"), "--out", str(folder / "out"), *changes, "--json")
    assert (found["finished"], found["failed"]) == (6, [])
    return folder / "out"


def test_a_detector_that_sees_the_attack_leads_one_that_does_not(study: Path, tmp_path: Path) -> None:
    file = tmp_path / "scores.json"
    command("study", "score", str(study), "--out", str(file), "--json")
    scores = {one.detector: one.sets[0] for one in read_scores(file).detectors}
    assert set(scores) == {"gnss", "gap", "always", "never", "by-time"}
    gnss, gap = scores["gnss"].detection, scores["gap"].detection
    assert gnss is not None
    assert gap is not None
    assert gnss.recall.value == 1.0
    assert gap.recall.value == 0.0
    board = command("study", "score", str(study), "--beside", str(file))
    assert board.index("gnss") < board.index("gap")
    assert (study / "scores.json").is_file()


def test_the_runs_make_a_data_set_whose_blocks_lie_in_one_split(study: Path, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    made = command("dataset", "build", str(study), str(tmp_path / "data"), "--json")
    assert made["runs"] == 12
    runs = pq.read_table(tmp_path / "data" / "runs.parquet").to_pylist()
    assert len({(row["block"], row["split"]) for row in runs}) == 6
    assert (tmp_path / "data" / "croissant.json").is_file()
    with pytest.raises(InputError, match="10 are needed"):
        command("dataset", "audit", str(tmp_path / "data"))


def test_options_replace_what_a_study_holds_out(study: Path, tmp_path: Path) -> None:
    made = command("dataset", "build", str(study), str(tmp_path / "held"), "--hold-out-fleet", "1", "--json")
    assert made["splits"] == {"heldout_fleet": 12}
    with pytest.raises(InputError, match="split validation"):
        command("study", "score", str(study), "--hold-out-fleet", "1")
    with pytest.raises(InputError, match="gnss_false_position"):
        command("study", "score", str(study), "--hold-out-family", "gnss_false_positions")


def test_a_data_set_has_the_splits_of_the_file(study: Path, tmp_path: Path) -> None:
    other = tmp_path / "study"
    shutil.copytree(study, other)
    data = json.loads((other / "study.json").read_text())
    data["study"]["held_out"]["families"] = ["gnss_false_position"]
    (other / "study.json").write_text(json.dumps(data))
    made = command("dataset", "build", str(other), str(tmp_path / "data"), "--json")
    assert made["splits"] == {"heldout_family": 12}


def test_a_study_without_whole_runs_makes_no_data_set(study: Path, tmp_path: Path) -> None:
    text = (study / "study.json").read_text().replace('"keep": "everything"', '"keep": "results"')
    (tmp_path / "blocks").mkdir()
    (tmp_path / "study.json").write_text(text)
    with pytest.raises(InputError, match="everything"):
        command("dataset", "build", str(tmp_path), str(tmp_path / "data"))


@pytest.mark.parametrize("name", sorted(SHIPPED))
def test_the_scenarios_of_the_shipped_studies_are_right(name: str) -> None:
    study = read_study(name)
    check_blocks(study, list_blocks(study))


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
