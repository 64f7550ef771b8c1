"""Every shipped kind of avoidance keeps its contract, and each rule is broken by one that breaks just that rule."""

from __future__ import annotations

import importlib.util
import itertools
import time
from typing import Any

import pytest

from skyrange.contracts.params import Number
from skyrange.contracts.plugins.registry import AVOIDANCE as GROUP
from skyrange.contracts.plugins.registry import kinds
from skyrange.core.time import Time
from skyrange.testing import NonConformance, check_avoidance
from skyrange.testing.checks.avoidance import AVOIDANCE
from skyrange.vehicle.avoidance.contract import (
    KEEP,
    AvoidanceAction,
    AvoidanceDecision,
    AvoidanceLimits,
    AvoidancePlugin,
    Episode,
    Own,
    Tracks,
)
from skyrange.vehicle.avoidance.stop import Stop


@pytest.mark.catalogue
@pytest.mark.parametrize("kind", kinds(GROUP))
def test_shipped_kinds_conform(kind: str) -> None:
    if kind == "orca" and importlib.util.find_spec("pyrvo") is None:
        pytest.skip("pyrvo is not installed (pip install 'skyrange[orca]')")
    check_avoidance(AvoidancePlugin.find(kind), {"protected_m": 25})


class Holds:
    """Stops while anybody is there: keeps every rule."""

    def __init__(self) -> None:
        self.limits: Any = AvoidanceLimits()

    def decide(self, now: Time, own: Own, tracks: Tracks, episode: Episode | None) -> Any:
        if len(tracks.pos_enu_m) == 0:
            return KEEP if episode is None else AvoidanceDecision(AvoidanceAction.RESUME, None)
        return self.hold(now, own, episode or Episode(now, own.pos_enu_m))

    def hold(self, now: Time, own: Own, episode: Episode) -> Any:
        return AvoidanceDecision(AvoidanceAction.STOP, episode)


def holding(decision: Any) -> type[Holds]:
    class Breaks(Holds):
        def hold(self, now: Time, own: Own, episode: Episode) -> Any:
            return decision(now, own, episode)

    return Breaks


class Undescribed(AvoidanceLimits):
    beyond_m: Number = 3.0


class Limitless(Holds):
    def __init__(self) -> None:
        self.limits = None


class Nervous(Holds):
    def decide(self, now: Time, own: Own, tracks: Tracks, episode: Episode | None) -> Any:
        return AvoidanceDecision(AvoidanceAction.STOP, episode or Episode(now, own.pos_enu_m))


class Endless(Holds):
    def decide(self, now: Time, own: Own, tracks: Tracks, episode: Episode | None) -> Any:
        if episode is not None:
            return AvoidanceDecision(AvoidanceAction.STOP, episode)
        return super().decide(now, own, tracks, episode)


TICKETS = itertools.count()


class Counts(Holds):
    def hold(self, now: Time, own: Own, episode: Episode) -> Any:
        return AvoidanceDecision(AvoidanceAction.GO, episode, (float(next(TICKETS)), 0.0, 30.0))


class Clocked(Holds):
    def hold(self, now: Time, own: Own, episode: Episode) -> Any:
        time.monotonic()
        return super().hold(now, own, episode)


class Uncopied(Holds):
    def __deepcopy__(self, memo: object) -> Any:
        raise TypeError("a handle")


def test_the_unbroken_one_conforms() -> None:
    check_avoidance(Holds)


BREAKING: list[tuple[str, Any]] = [
    ("described", AvoidancePlugin(Undescribed, lambda limits, context: Stop(None, limits), "Stops.")),
    ("described", AvoidancePlugin(AvoidanceLimits, lambda limits, context: Stop(None, limits), "stops")),
    ("limits", Limitless),
    ("decides", holding(lambda now, own, episode: None)),
    ("decides", holding(lambda now, own, episode: AvoidanceDecision(AvoidanceAction.GO, episode))),
    ("decides", holding(lambda now, own, episode: AvoidanceDecision(AvoidanceAction.STOP, episode, (0.0, 0.0, 0.0)))),
    (
        "decides",
        holding(lambda now, own, episode: AvoidanceDecision(AvoidanceAction.GO, episode, (float("nan"), 0.0, 0.0))),
    ),
    ("decides", holding(lambda now, own, episode: AvoidanceDecision(AvoidanceAction.STOP, episode, None, (99,)))),
    ("decides", holding(lambda now, own, episode: 1 / 0)),
    ("episodes", holding(lambda now, own, episode: AvoidanceDecision(AvoidanceAction.STOP, None))),
    (
        "episodes",
        holding(lambda now, own, episode: AvoidanceDecision(AvoidanceAction.STOP, Episode(now + 1, own.pos_enu_m))),
    ),
    ("alone", Nervous),
    ("ends", Endless),
    ("repeatable", Counts),
    ("pure", Clocked),
    ("copies", Uncopied),
]


@pytest.mark.parametrize(("rule", "broken"), BREAKING, ids=[f"{k}-{rule}" for k, (rule, _) in enumerate(BREAKING)])
def test_a_broken_rule_is_found(rule: str, broken: Any) -> None:
    with pytest.raises(NonConformance) as found:
        check_avoidance(broken)
    assert found.value.rule == f"avoidance.{rule}", str(found.value)


def test_every_rule_is_shown_to_fail() -> None:
    assert {f"avoidance.{rule}" for rule, _ in BREAKING} == {rule.id for rule in AVOIDANCE.rules}
