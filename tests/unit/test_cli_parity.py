"""What `skyrange parity` prints, of comparisons that were not flown."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.parity import flights as parity
from skyrange.parity.flights import FlightMeasures, Parity
from skyrange.scenario.model.scenario import Scenario
from tools.agreement import __main__ as agreement
from tools.agreement import gnss_reactions as reactions
from tools.agreement.gnss_reactions import ComparedReaction, Reaction, Setting

JUMP = Setting("gnss.jump", {"offset_m": [30.0, 0.0, 0.0]})
RESET = Reaction(1.2, 20.1, ((10.0, 30.0),), None, 30.0)
FOLLOWED = Reaction(None, None, (), None, 29.0)


@pytest.fixture
def compared(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    given: list[Any] = []

    def compare(folder: Path, chosen: Any, rates: str, **_: Any) -> list[ComparedReaction]:
        given.append((folder, len(chosen), rates))
        return [ComparedReaction(JUMP, RESET, RESET), ComparedReaction(JUMP, RESET, FOLLOWED)]

    monkeypatch.setattr(reactions, "compare", compare)
    return given


def flown(height_m: float, items: tuple[tuple[float, int], ...], autopilot: str) -> FlightMeasures:
    path = np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, height_m]])
    measures = {"height_max_m": height_m, "rest_s": 0.0}
    return FlightMeasures("op/a", autopilot, "complete", ((5.0, "AUTO"),), items, measures, {"HEARTBEAT": 9}, {}, path)


def test_gnss_says_how_many_are_alike_and_which_differ(compared: list[Any], tmp_path: Path) -> None:
    said = CliRunner().invoke(agreement.app, ["gnss", "--out", str(tmp_path / "g")], env={"COLUMNS": "160"})
    assert said.exit_code == 0, said.output
    assert compared == [(tmp_path / "g", 100, "reduced")]
    assert "jump 30, 0, 0 m" in said.output
    assert said.output.count("differs") == 1
    assert "same outcome in 1 of 2" in said.output
    assert "both reset in 1: 1 within 1 s, at most 0.00 s" in said.output


def test_gnss_as_json(compared: list[Any], tmp_path: Path) -> None:
    asked = ["gnss", "--out", str(tmp_path), "--rates", "full", "--json"]
    said = json.loads(CliRunner().invoke(agreement.app, asked).stdout)
    assert compared[0][2] == "full"
    assert (said["settings"], said["alike"], said["together"]) == (2, 1, 1)
    differs = said["settings_flown"][1]
    assert (differs["builtin"]["outcome"], differs["ardupilot"]["outcome"]) == ("reset", "followed")
    assert differs["builtin"]["resets"] == [[10.0, 30.0]]


def test_flight_says_measures_and_what_differs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    one, other = flown(5.0, ((9.0, 1), (12.0, 2)), "builtin"), flown(4.0, ((9.1, 1),), "ardupilot")
    monkeypatch.setattr(parity, "compare", lambda *_, **__: Parity({"op/a": one}, {"op/a": other}))
    asked = ["parity", "flight", "squares", "--out", str(tmp_path)]
    said = CliRunner().invoke(app, asked, env={"COLUMNS": "160"})
    assert said.exit_code == 0, said.output
    (height,) = [line for line in said.output.splitlines() if "height_max_m" in line]
    assert [cell.strip() for cell in height.split("│")[3:7]] == ["5.00", "4.00", "+1.00", "+25.0%"]
    assert "op/a: items 1, 2 with the builtin, 1 with ArduPilot" in said.output
    assert "modes" not in said.output
    assert "op/a: at most 1.0 m apart" in said.output
    told = json.loads(CliRunner().invoke(app, [*asked, "--json"]).stdout)
    assert told["apart_m"] == {"op/a": 1.0}
    assert [each["autopilot"] for each in told["flights"]] == ["builtin", "ardupilot"]


def test_rates_are_told_by_their_names(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    one, other = (flown(height_m, ((9.0, 1),), "ardupilot") for height_m in (5.0, 4.0))
    given: list[Any] = []

    def compare_rates(scenario: Scenario, folder: Path, rates: str, **_: Any) -> Parity:
        given.append((scenario.name, folder, rates))
        return Parity({"op/a": one}, {"op/a": replace(other, outcome="unfinished")})

    monkeypatch.setattr(parity, "compare_rates", compare_rates)
    asked = ["rates", "squares", "--rates", "single", "--out", str(tmp_path)]
    said = CliRunner().invoke(agreement.app, asked, env={"COLUMNS": "160"})
    assert said.exit_code == 0, said.output
    assert given == [("squares", tmp_path, "single")]
    assert "op/a: outcome complete with full rates, unfinished with single rates" in said.output
    told = json.loads(CliRunner().invoke(agreement.app, [*asked, "--json"]).stdout)
    assert [(each["under"], each["measures"]["height_max_m"]) for each in told["flights"]] == [
        ("full", 5.0),
        ("single", 4.0),
    ]


def test_own_rates_are_not_compared_with_themselves() -> None:
    said = CliRunner().invoke(agreement.app, ["rates", "squares", "--rates", "full"], env={"COLUMNS": "160"})
    assert said.exit_code == 2
    assert "'single', 'reduced'" in said.output
