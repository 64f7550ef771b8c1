"""Does the builtin react to false GNSS as a real EKF3 does? Half of the hundred settings, both in one run.

`python -m tools.agreement gnss` flies them all.
"""

from __future__ import annotations

import pytest

from tests.ardupilot import needs_arducopter
from tests.catalogue import in_turn
from tools.agreement.gnss_reactions import TIME_S, ComparedReaction, agreement, compare, settings

IN_TURN = in_turn("parity", "gnss")


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> list[ComparedReaction]:
    chosen = [setting for number, setting in enumerate(settings()) if number % 4 in (0, 3)]  # each direction in turn
    return compare(tmp_path_factory.mktemp("gnss") / "run", chosen)


@IN_TURN
@needs_arducopter
def test_the_outcome_is_the_same_in_95_percent(compared: list[ComparedReaction]) -> None:
    found = agreement(compared)
    strays = [f"{one.setting.description}: {one.first} against {one.second}" for one in compared if not one.alike]
    assert found.settings == 50
    assert found.alike >= 0.95 * found.settings, strays


@IN_TURN
@needs_arducopter
def test_resets_are_within_a_second(compared: list[ComparedReaction]) -> None:
    found = agreement(compared)
    assert found.resets >= 10
    assert found.together == found.resets
    assert found.reset_apart_max_s <= TIME_S


@IN_TURN
@needs_arducopter
def test_the_settings_reach_every_outcome(compared: list[ComparedReaction]) -> None:
    seen = {one.second.outcome for one in compared}
    assert seen == {"ignored", "followed", "doubted, then followed", "reset", "failsafe"}
