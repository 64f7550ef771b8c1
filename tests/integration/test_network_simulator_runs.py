"""Whole runs whose air is a network simulator: they repeat, fork, and equal their twin up to the onset."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skyrange import load, pair
from skyrange.core.time import NS_PER_S
from skyrange.metrics.exact_difference import diff
from skyrange.runtime.run import Run
from skyrange.scenario.shipped import load as load_scenario
from skyrange.study.runs import fly
from tests.radio_engines import needs_ns3, needs_omnetpp

ENGINES = [pytest.param("ns3", marks=needs_ns3), pytest.param("omnetpp", marks=needs_omnetpp)]


def _rows(folder: Path, table: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = load(folder).table(table).to_pylist()
    return rows


@pytest.mark.parametrize("engine", ENGINES)
def test_a_fork_in_mid_flight_goes_on_alike(engine: str, tmp_path: Path) -> None:
    scenario = load_scenario("rid-spoofing", [f'radio.engine="{engine}"', "duration_s=50"])
    straight = fly(scenario, tmp_path / "straight", report=False)
    trunk = Run.start(scenario, tmp_path / "trunk")
    trunk.advance(34.345)  # no tick of the oracle; the attack is on
    branch = trunk.fork(tmp_path / "branch")
    for part in (branch, trunk):
        part.advance(50.0)
        part.finish()
    late = [row for row in _rows(tmp_path / "straight", "receptions") if row["time_ns"] > 34.345 * NS_PER_S]
    assert len(late) > 30
    for name in ("trunk", "branch"):
        assert load(tmp_path / name).manifest["digests"] == straight.manifest["digests"]
        assert _rows(tmp_path / name, "receptions") == _rows(tmp_path / "straight", "receptions")
        assert diff(load(tmp_path / name), straight).same


@pytest.mark.parametrize("engine", ENGINES)
def test_twins_are_equal_up_to_the_onset(engine: str, tmp_path: Path) -> None:
    scenario = load_scenario("rid-spoofing", [f'radio.engine="{engine}"', "duration_s=70"])
    pair(scenario, tmp_path / "pair")
    attacked, nominal = (load(tmp_path / "pair" / name) for name in ("attacked", "nominal"))
    onset = min(row["at_ns"] for row in attacked.table("labels").to_pylist())
    assert onset == 30 * NS_PER_S
    for table in ("receptions", "truth"):
        before = [
            [row for row in record.table(table).to_pylist() if row["time_ns"] < onset] for record in (attacked, nominal)
        ]
        assert before[0] == before[1]
        assert len(before[0]) > 30
    assert attacked.manifest["medium"]["kind"] == engine
