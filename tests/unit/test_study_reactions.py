"""Reactions read by `tools.agreement.gnss_reactions` from a run of the builtin in both roles: they agree."""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.scenario.model.scenario import Scenario
from skyrange.study.runs import fly
from tools.agreement.gnss_reactions import (
    ALT_M,
    HOLD,
    SECONDS,
    START_S,
    ComparedReaction,
    Reaction,
    Setting,
    agreement,
    read,
    scenario,
    settings,
)

pytestmark = pytest.mark.rotating

CHOSEN = (
    Setting("gnss.jump", {"offset_m": [6.0, 0.0, 0.0]}),
    Setting("gnss.jump", {"offset_m": [0.0, -30.0, 0.0]}),
    Setting("gnss.jump", {"offset_m": [0.0, 0.0, 30.0]}),
    Setting("gnss.drift", {"rate_mps": [3.0, 0.0, 0.0], "velocity": "consistent"}),
    Setting("gnss.drift", {"rate_mps": [15.0, 0.0, 0.0], "velocity": "consistent"}),
)


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> list[ComparedReaction]:
    folder = tmp_path_factory.mktemp("reactions")
    mission = folder / "hold.waypoints"
    mission.write_text(HOLD.format(alt=ALT_M, hold=START_S + SECONDS))
    model: dict[str, Any] = scenario(CHOSEN, mission).model_dump(exclude_unset=True)
    for operator in model["operators"]:
        for vehicle in operator["vehicles"]:
            vehicle["autopilot"] = "builtin"
    return read(fly(Scenario.model_validate(model), folder / "run", report=False), CHOSEN)


@pytest.mark.slow
def test_it_is_like_itself(compared: list[ComparedReaction]) -> None:
    found = agreement(compared)
    # both the jump and, after its failsafe, the fast drift are reset
    assert (found.settings, found.alike, found.resets, found.together) == (5, 5, 2, 2)
    assert found.reset_apart_max_s <= 0.4  # two receivers' fixes are out of step by up to one interval, 0.2 s


def test_outcomes_and_times(compared: list[ComparedReaction]) -> None:
    seen = [one.first for one in compared]
    assert [one.outcome for one in seen] == ["followed", "reset", "ignored", "doubted, then followed", "failsafe"]
    jump = seen[1]
    assert jump.glitch_s == pytest.approx(1.25, abs=0.5)
    assert jump.reset_s == pytest.approx(10.0, abs=0.5)
    assert jump.resets[0][1] == pytest.approx(30.0, rel=0.1)
    assert jump.led_m == pytest.approx(30.0, abs=1.5)
    assert seen[0].led_m == pytest.approx(6.0, abs=0.5)
    assert seen[2].led_m < 0.5
    assert seen[3].led_m == pytest.approx(3.0 * SECONDS, rel=0.1)
    assert 0.5 < (seen[4].failsafe_s or 0.0) < 3.0


def test_a_hundred_settings_each_once() -> None:
    descriptions = [setting.description for setting in settings()]
    assert len(descriptions) == len(set(descriptions)) == 100


def test_alike_means_outcome_and_place() -> None:
    setting = CHOSEN[0]
    calm = Reaction(None, None, (), None, 6.0)
    assert ComparedReaction(setting, calm, Reaction(None, None, (), None, 7.9)).alike
    assert not ComparedReaction(setting, calm, Reaction(None, None, (), None, 8.1)).alike
    grounded = Reaction(None, None, (), None, 0.0, took_off=False)
    assert not ComparedReaction(setting, grounded, grounded).alike
    assert not ComparedReaction(setting, calm, Reaction(1.2, 9.0, (), None, 6.0)).alike
    late = ComparedReaction(
        setting, Reaction(1.2, None, ((10.0, 6.0),), None, 6.0), Reaction(1.2, None, ((8.5, 6.0),), None, 6.0)
    )
    assert late.alike
    assert late.reset_apart_s == pytest.approx(1.5)
    assert agreement([late]).together == 0
