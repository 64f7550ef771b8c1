"""Paths from attacks to their effects in every shipped scenario with an attack; effects without a path are listed."""

from __future__ import annotations

import pytest

from skyrange.scenario.shipped import SHIPPED, load
from tests.catalogue import in_turn
from tests.flights import shared_pair

NO_PATH: dict[str, set[str]] = {
    "chain": set(),
    "emergency-landing": set(),
    "falsified-log": set(),
    "gcs-flood": set(),
    "gnss-drift": set(),
    "gnss-pull-off": set(),
    "hijack": set(),
    "insider": set(),
    "jam-then-spoof": set(),
    "jammed-corridor": set(),
    "mitm-mission": set(),
    "rid-spoofing": set(),
    "rid-city": set(),
    "unsigned-ghost": set(),
}
"""By scenario, the aircraft whose departure is confirmed and to which the record does not lead from its author."""


def test_every_shipped_scenario_with_an_attack_is_here() -> None:
    assert {name for name in SHIPPED if load(name).attacks} == NO_PATH.keys()


RID_CITY = pytest.param("rid-city", marks=(pytest.mark.slow, in_turn("parity", "paths of rid-city")))
DEAR = ("gcs-flood", "gnss-pull-off", "insider", "jammed-corridor", "unsigned-ghost")
"""Pairs of long flights, ten seconds and more each."""
OTHERS = sorted(set(NO_PATH) - {"chain", "rid-city", *DEAR})


@pytest.mark.slow
def test_every_effect_of_the_chain_has_a_path() -> None:
    assert_effects_without_a_path("chain")  # other tests read this pair too


@pytest.mark.catalogue
@pytest.mark.parametrize("name", [*OTHERS, *(pytest.param(one, marks=pytest.mark.slow) for one in DEAR), RID_CITY])
def test_effects_without_a_path_are_the_ones_that_are_known(name: str) -> None:
    assert_effects_without_a_path(name)


def assert_effects_without_a_path(name: str) -> None:
    """Each departure that is confirmed is an effect, and those without a path are the ones that are known."""
    made = shared_pair(name)
    effects = [row for row in made.propagation.to_pylist() if row["phase"] == "effect"]
    departed = {row["vehicle"] for row in made.attribution.to_pylist() if row["outcome"] == "departure"}
    assert departed
    assert {row["vehicle"] for row in effects} == departed
    assert {row["relation"] for row in effects} == {"both"}
    assert {row["vehicle"] for row in effects if not row["path"]} == NO_PATH[name]
