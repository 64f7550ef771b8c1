"""The radio bench measures what it says. No figure is asserted: figures belong to machines."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from skyrange.bench.radio import PER_KM2, measure
from skyrange.cli.app import app
from skyrange.core.errors import ComponentError, InputError
from skyrange.radio.external.ns3 import VARIABLE
from tests.integration.radio_program import write_program


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


def test_the_time_of_an_engine_that_is_a_program_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = write_program(tmp_path)
    answer = "            link.answer(130,"
    assert answer in program.read_text()
    program.write_text(program.read_text().replace(answer, f"            sum(range(200_000))\n{answer}"))
    monkeypatch.setenv(VARIABLE, str(program))
    row = measure(40, 1.0, engine="ns3")
    assert row["engine"] == "ns3"
    assert 0.0 < row["engine_cpu_s"] < row["cpu_s"]  # several ticks of the system's clock
    assert row["heard_by"] > 1.0
    assert row["line_of_sight_share"] is None
    assert measure(5, 1.0)["engine_cpu_s"] == 0.0


def test_a_row_without_sight_lines_is_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(write_program(tmp_path)))
    done = CliRunner().invoke(app, ["bench", "radio", "--nodes", "5", "--seconds", "1", "--engine", "ns3"])
    assert done.exit_code == 0
    head, row = (line.split() for line in done.stdout.splitlines())
    assert head[0] == "nodes"
    assert len(row) == 6


def test_an_engine_that_is_not_known_is_an_error() -> None:
    with pytest.raises(InputError, match="nosuch"):
        measure(5, 1.0, engine="nosuch")


def test_nobody_to_hear_is_an_error() -> None:
    with pytest.raises(ComponentError, match="nobody to hear"):
        measure(1, 1.0)
