"""Detectors in a study: their scores, and the data set of its runs, by the commands that a user types."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.core.errors import InputError
from skyrange.study.scoring.result_file import read_scores
from skyrange.study.sweep.blocks import check_blocks, list_blocks
from skyrange.study.sweep.model import SHIPPED, read_study

TEXT = """
name = "small"
keep = "everything"
scenario = "gnss.jump"
changes = ["duration_s=36", "operators.*.streams=operator"]
seeds = 6
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
    found = command("study", "run", str(folder / "small.toml"), "--out", str(folder / "out"), "--json")
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
    with pytest.raises(InputError, match="too few blocks: 6 with both arms"):
        command("dataset", "audit", str(tmp_path / "data"))


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
