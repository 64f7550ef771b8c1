"""Missions that fail without an attack: every command that compares runs says so first, and exits with 4."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

pytestmark = pytest.mark.rotating

SCENARIO = """
name = "closed"
seed = 2
duration_s = 6
origin = [40.778, -73.955]

[[constraints]]
id = "fire"
corners_m = [[-40, 20], [40, 20], [40, 80], [-40, 80]]

[[operators]]
id = "blue"
approval = "authority"
[[operators.vehicles]]
id = "b1"
plan = {{ path = {{ points = [[0, 0, 15], [0, 120, 15]] }}, end = "land", failure_expected = {expected} }}

[[attacks]]
id = "lag"
kind = "link.delay"
start_s = 4
params = {{ links = ["gcs:*"], delay_s = 0.2 }}
muted = {muted}
"""
MATRIX = """
name = "small"
seeds = 1
[[rows]]
id = "lag"
scenario = "s.toml"
measure = "departure_m"
[[columns]]
id = "signing"
  [[columns.defences]]
  kind = "mavlink.signing"
"""
STUDY = """
name = "small"
scenario = "s.toml"
arms = ["nominal", "attacked"]
"""
COMMANDS = {
    "pair": ["pair", "s.toml", "--arms", "nominal"],
    "compare": ["compare", "s.toml", "--variant", "slow:operators.*.vehicles.*.plan.speed_mps=3"],
    "matrix": ["matrix", "m.toml", "--jobs", "1"],
    "study": ["study", "run", "study.toml", "--jobs", "1"],
}


@pytest.mark.parametrize("expected", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", COMMANDS)
def test_a_mission_that_fails_without_an_attack_is_told_first_and_by_the_exit_code(
    name: str,
    expected: bool,
    tmp_path: Path,
    command: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    muted = json.dumps(name == "compare")
    Path("s.toml").write_text(SCENARIO.format(expected=json.dumps(expected), muted=muted))
    Path("m.toml").write_text(MATRIX)
    Path("study.toml").write_text(STUDY)
    code = command(*COMMANDS[name], "--out", "out")
    told = capsys.readouterr()
    assert code == (0 if expected else 4), told.err
    first = told.out.splitlines()[0]
    assert ("1 of 1 mission failed: blue/b1: " in first) == (not expected), told.out
    assert ("missions failed without an attack" in " ".join(told.err.split())) == (not expected)
