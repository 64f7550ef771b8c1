"""Ends of the effects of attacks, from a run's own notes."""

from __future__ import annotations

from typing import get_args

import pytest

from skyrange.attack.contract import AttackPlugin, Persistence
from skyrange.contracts.plugins.registry import ATTACKS, kinds
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.metrics.effect_ends import find_effect_end_ns
from skyrange.metrics.time_series import RecordedNote

END_S = 300.0


def notes(*rows: tuple[float, str]) -> list[RecordedNote]:
    return [RecordedNote(from_seconds(at_s), kind, "a/1", "", {}, ()) for at_s, kind in rows]


def end_s(persists: Persistence, last_s: float, *fleet: list[RecordedNote]) -> float:
    table = {str(number): own for number, own in enumerate(fleet)}
    return find_effect_end_ns(persists, from_seconds(last_s), list(table), table, from_seconds(END_S)) / NS_PER_S


FLIGHT = notes(
    (1.0, "decision.connected"), (1.5, "event.mission"), (2.0, "decision.streams_set"), (2.1, "event.mode"),
    (4.0, "event.armed"), (5.0, "decision.departing"), (5.1, "event.mode"), (6.0, "event.takeoff"),
    (40.0, "event.mode"), (90.0, "decision.gave_up"), (90.2, "event.mode"), (110.0, "event.landed"),
    (112.0, "event.disarmed"),
)  # fmt: skip


@pytest.mark.parametrize(
    ("persists", "last_s", "expected_s"),
    [
        ("acts", 30.0, 30.0),
        ("flight", 30.0, 112.0),
        ("upload", 30.0, 112.0),  # never uploaded again
        ("upload", 1.3, 112.0),  # the upload that was altered is not one that mends it
        ("upload", 0.5, 1.5),
        ("mode", 30.0, 90.2),  # not at 40 s: no decision of the ground station led to it
        ("mode", 95.0, 112.0),
        ("mode", 3.0, 5.1),
        ("flight", 1.3, 112.0),  # on the ground: the flight that follows is altered
        ("flight", 112.0, 112.0),
        ("flight", 150.0, 150.0),  # no flight follows
        ("mode", 150.0, 150.0),
    ],
)
def test_the_end_of_an_effect(persists: Persistence, last_s: float, expected_s: float) -> None:
    assert end_s(persists, last_s, FLIGHT) == expected_s


def test_a_flight_that_does_not_end_lasts_to_the_end_of_the_run() -> None:
    aloft = notes((4.0, "event.armed"), (6.0, "event.takeoff"))
    assert end_s("flight", 30.0, aloft) == END_S
    assert end_s("acts", 30.0, aloft) == 30.0


@pytest.mark.parametrize("kind", ["event.crash", "event.autopilot_lost", "event.disarmed"])
def test_what_ends_a_flight(kind: str) -> None:
    assert end_s("flight", 10.0, notes((4.0, "event.armed"), (50.0, kind), (80.0, "event.disarmed"))) == 50.0


def test_on_a_whole_run_it_lasts_until_the_last_flight_has_ended() -> None:
    late = notes((20.0, "event.armed"), (130.0, "event.disarmed"))
    assert end_s("flight", 30.0, FLIGHT, late) == 130.0
    assert end_s("flight", 120.0, FLIGHT, late) == 130.0
    assert end_s("flight", 140.0, FLIGHT, late) == 140.0
    assert end_s("flight", 140.0) == 140.0


@pytest.mark.parametrize("name", kinds(ATTACKS))
def test_every_kind_says_what_ends_its_effect(name: str) -> None:
    kind = AttackPlugin.find(name)
    if " in skyrange." in kind.source:
        assert kind.persists in get_args(Persistence)
