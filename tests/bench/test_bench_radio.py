"""The radio bench measures what it says. No figure is asserted: figures belong to machines."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from skyrange.bench.radio import PER_KM2, measure
from skyrange.cli.app import app
from skyrange.core.errors import ComponentError


def test_a_row_says_what_was_sent_and_heard() -> None:
    row = measure(40, 2.0)
    assert row["nodes"] == 40
    assert row["per_km2"] == PER_KM2
    assert row["transmissions_per_s"] * row["cpu_s"] == pytest.approx(80.0, rel=0.05)  # both are rounded
    assert row["receptions_per_s"] * row["cpu_s"] == pytest.approx(80.0 * row["heard_by"], rel=0.05)
    assert row["real_time_factor"] * row["cpu_s"] == pytest.approx(2.0, rel=0.05)
    assert 1.0 < row["heard_by"] < 39.0
    assert 0 < row["lines_per_s"] <= 40 * 39
    assert 0.0 < row["line_of_sight_share"] < 1.0


def test_a_nearer_horizon_is_less_work() -> None:
    near, far = measure(60, 1.0, 150.0), measure(60, 1.0, 900.0)
    assert near["lines_per_s"] < far["lines_per_s"]
    assert near["heard_by"] < far["heard_by"]


def test_json_is_a_list_of_rows() -> None:
    done = CliRunner().invoke(app, ["bench", "radio", "--nodes", "5", "--nodes", "10", "--seconds", "1", "--json"])
    rows = json.loads(done.stdout)
    assert [row["nodes"] for row in rows] == [5, 10]
    assert all({"real_time_factor", "receptions_per_s", "line_of_sight_share"} <= set(row) for row in rows)


def test_nobody_to_hear_is_an_error() -> None:
    with pytest.raises(ComponentError, match="nobody to hear"):
        measure(1, 1.0)
