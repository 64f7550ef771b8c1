"""Attack minus sham over seeds, with its interval: through the command line, and worked out again by hand."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.core.errors import InputError
from skyrange.twins.pair_folder import load_pair
from tests.integration.twin_range import plain

pytestmark = pytest.mark.slow

T_975_1 = math.tan(0.475 * math.pi)
"""Student's t, 0.975 quantile, one degree of freedom, which has a closed form: 12.706 in tables."""
ATTACK = """
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 12
params = { at = [45, 0, 30] }
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("ensemble")
    (folder / "s.toml").write_text(plain(26, own='avoidance = "geometric"', more=ATTACK))
    asked = ["pair", str(folder / "s.toml"), "--seeds", "2", "--jobs", "1", "--json", "--out", str(folder / "out")]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.slow
def test_the_arms_and_seeds_that_were_asked_for(told: dict[str, Any]) -> None:
    assert told["arms"] == ["nominal", "attacked", "sham"]
    assert told["seeds"] == [5, 6]
    assert told["status"] == "complete"
    assert len(told["runs"]) == 6
    assert Path(told["report"]).exists()
    assert {(row["seed"], row["against"], row["vehicle"]) for row in told["effects"]} == {
        (seed, arm, vehicle) for seed in (5, 6) for arm in ("nominal", "sham") for vehicle in ("blue/b1", "blue/b2")
    }
    assert pytest.approx(12.706, abs=5e-4) == T_975_1


def test_intervals_are_attack_minus_sham_by_hand(told: dict[str, Any]) -> None:
    """From the runs' own truth: length of the path, attacked minus sham of the same seed, mean ± t s/√2."""
    made = load_pair(told["path"])

    def length_m(arm: str, seed: int, vehicle: str) -> float:
        rows = [row for row in made.run(arm, seed).table("truth").to_pylist() if row["vehicle"] == vehicle]
        places = [(row["east_m"], row["north_m"], row["up_m"]) for row in rows]
        return math.fsum(math.dist(a, b) for a, b in itertools.pairwise(places))

    for vehicle in ("blue/b1", "blue/b2"):
        extra = [length_m("attacked", seed, vehicle) - length_m("sham", seed, vehicle) for seed in made.seeds]
        mean = sum(extra) / 2
        half = T_975_1 * math.sqrt(sum((x - mean) ** 2 for x in extra)) / math.sqrt(2)
        found = told["intervals"][vehicle]["extra_distance_m"]
        assert (found["n"], found["mean"]) == (2, pytest.approx(mean, abs=1e-6))
        if half == 0.0:
            assert (found["low"], found["method"]) == (None, "all agree")
            continue
        assert (found["low"], found["high"]) == (
            pytest.approx(mean - half, abs=1e-6),
            pytest.approx(mean + half, abs=1e-6),
        )
    departures = [
        row["departure_m"] for row in told["effects"] if (row["vehicle"], row["against"]) == ("blue/b1", "sham")
    ]
    assert len(departures) == 2
    assert told["intervals"]["blue/b1"]["departure_m"]["mean"] == pytest.approx(sum(departures) / 2)
    assert min(departures) > 1.0, "the ghost stands in its way whatever the seed"


def test_people_are_told_the_same(told: dict[str, Any], tmp_path: Path) -> None:
    page = Path(told["report"]).read_text(encoding="utf-8")
    for words in ("Over 2 seeds", "Against the sham", "blue/b1"):
        assert words in page


def test_a_folder_that_is_taken_is_refused(told: dict[str, Any]) -> None:
    done = CliRunner().invoke(app, ["pair", "rid-spoofing", "--out", told["path"]])
    assert isinstance(done.exception, InputError)
    assert done.exception.exit_code == 2
