"""Measures of `skyrange.parity.flights`; a flight does not differ from itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skyrange.core.errors import InputError
from skyrange.parity import flights as module
from skyrange.parity.flights import Parity, compare, compare_rates, measured
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Parity:
    changes = ["duration_s=60", "record.truth_hz=50", "sensors.noise=0"]
    first = measured(fly(load("squares", changes), tmp_path_factory.mktemp("parity") / "run", report=False))
    return Parity(first, first)


def test_measures_of_a_square(flown: Parity) -> None:
    """Side 5 m, 5 m up, departure at 10 s; four legs and a landing."""
    one = flown.first["blue/b1"]
    assert (one.autopilot, one.outcome) == ("builtin", "complete")
    assert [mode for _, mode in one.modes] == ["GUIDED", "AUTO"]
    assert [seq for _, seq in one.items] == [2, 3, 4, 5, 6]
    measures = one.measures
    assert 10.5 < measures["lift_off_s"] < 12.5
    assert [name for name in measures if name.startswith("leg_")] == [f"leg_{n}_s" for n in (1, 2, 3, 4)]
    total = sum(measures[f"leg_{n}_s"] for n in (1, 2, 3, 4)) + measures["rest_s"]
    assert measures["in_the_air_s"] == pytest.approx(total)
    assert measures["height_max_m"] == pytest.approx(5.0, abs=0.5)
    assert measures["turned_deg"] > 250.0  # towards each corner
    assert 0.0 < measures["cross_track_rms_m"] < measures["cross_track_max_m"] < 2.0
    assert one.sent["HEARTBEAT"] >= 60
    assert one.rates_hz["GLOBAL_POSITION_INT"] == pytest.approx(4.0, abs=0.1)
    assert one.rates_hz["HEARTBEAT"] == pytest.approx(1.0, abs=0.1)


def test_a_flight_is_no_way_from_itself(flown: Parity) -> None:
    rows = list(flown.rows())
    assert {row.vehicle for row in rows} == set(flown.first)
    assert {row.difference for row in rows} == {0.0}
    assert flown.apart_m("blue/b1") == 0.0


def test_a_difference_is_seen(flown: Parity) -> None:
    one = flown.first["blue/b1"]
    seconds, places = one.path
    measures = {**one.measures, "speed_max_mps": 1.1 * one.measures["speed_max_mps"]}
    other = replace(one, path=(seconds, places + np.array([0.0, 3.0, 4.0])), measures=measures)
    parity = Parity({"blue/b1": other}, {"blue/b1": one})
    assert parity.apart_m("blue/b1") == pytest.approx(5.0)
    far = {row.measure: row.relative for row in parity.rows() if row.difference}
    assert far == {"speed_max_mps": pytest.approx(0.1)}


def test_one_kind_is_not_compared_with_itself(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="two kinds"):
        compare(load("squares"), tmp_path, ("builtin", "builtin"))


def test_a_missing_arducopter_is_told_before_the_first_flight(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SKYRANGE_ARDUCOPTER", str(tmp_path / "none"))
    with pytest.raises(InputError, match="no such file"):
        compare(load("squares"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_rates_are_flown_by_ardupilots_that_differ_in_them_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: dict[str, Scenario] = {}

    def note(scenario: Scenario, folder: Path, **_: Any) -> None:
        asked[folder.name] = scenario

    monkeypatch.setattr(module, "measured", lambda _: {})
    monkeypatch.setattr(module, "build", lambda _: None)  # there need not be an ArduCopter
    monkeypatch.setattr(module, "fly", note)
    compare_rates(load("squares", ["autopilots.options.ardupilot.keep_logs=true"]), tmp_path, "single")
    assert list(asked) == ["full", "single"]
    for name, scenario in asked.items():
        assert scenario.autopilots.options == {"ardupilot": {"keep_logs": True, "rates": name}}
        assert {one.autopilot for operator in scenario.operators for one in operator.vehicles} == {"ardupilot"}
    same = {"autopilots": asked["full"].autopilots}
    assert asked["single"].model_copy(update=same) == asked["full"]


def test_rates_that_do_not_go_with_the_scenario_are_told_before_it_flies(tmp_path: Path) -> None:
    scenario = load("squares", ["autopilots.options.ardupilot.physics=native"])
    with pytest.raises(InputError, match=r"options\.ardupilot\.rates: 'single' — expected 'full' or 'reduced'"):
        compare_rates(scenario, tmp_path, "single")
    assert list(tmp_path.iterdir()) == []


def test_full_rates_are_not_compared_with_themselves(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="full rates"):
        compare_rates(load("squares"), tmp_path, "full")
