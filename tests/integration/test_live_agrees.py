"""Agreement of live ranges with runs in virtual time: shipped scenarios, the live range's transports in memory.

`test_live_range` has one on sockets; `live_agrees` flies all of them in real time, to their ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from skyrange.metrics.agreement import agreement
from skyrange.record import RunRecord
from skyrange.scenario.shipped import SHIPPED
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly
from tests.catalogue import draw
from tests.integration.live_agrees import FLIGHTS, RACES, TOLERANCE_S, Both, fly_both, virtual
from tests.integration.live_virtual import fly_virtual, prepared

pytestmark = pytest.mark.rotating

BRIEF = """
name = "brief"
seed = 4
duration_s = 11
origin = [-35.363328, 149.1652241]

[[operators]]
id = "blue"
vehicles = [{ id = "b1", plan = { path = { points = [[0.0, 4.0]], alt_m = 3.0 }, end = "land" } }]
"""
SQUARES = {"event.takeoff": 5, "event.item_reached": 10}
HEAD_ON = {"event.takeoff": 2, "event.collision": 2}


def assert_agrees(both: Both, seconds: float, happened: dict[str, int], items_s: float = 0.5) -> None:
    """Nothing in one alone, and so much in both; what is flown is at most `items_s` apart."""
    assert both.wrong == []
    assert both.found.until_s == pytest.approx(seconds, abs=TOLERANCE_S)
    for kind, least in happened.items():
        assert both.found.kinds[kind].found >= least, kind
    assert both.amount_s("event.item_reached") < items_s


def test_all_that_is_shipped_is_flown_by_the_table() -> None:
    assert set(FLIGHTS) == set(SHIPPED)


WHOLE: list[tuple[str, float, dict[str, int], float]] = [
    ("squares", 24.0, SQUARES, 0.5),
    ("head-on", 44.0, HEAD_ON, 0.5),
    (
        "gnss-drift", 80.0,
        {"event.item_reached": 1, "event.attack_start": 1, "event.collision": 1, "event.crash": 1}, 1.0,
    ),
    ("squares", 60.0, SQUARES | {"event.landed": 5}, 0.5),
    ("crossing", 140.0, {"event.takeoff": 3, "event.landed": 3}, 0.1),
    ("wind", 160.0, {"event.takeoff": 2, "event.landed": 2}, 0.1),
    ("survey", 185.0, {"event.takeoff": 1, "event.landed": 1}, 0.1),
    ("rid-spoofing", 155.0, {"event.takeoff": 2, "event.attack_start": 1}, 1.0),
]  # fmt: skip
"""Whole flights: name, seconds, how often what happens at least, and within how many seconds items are reached."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seconds", "happened", "items_s"), draw(WHOLE, 4))
def test_the_same_happens_within_the_tolerance(
    name: str, seconds: float, happened: dict[str, int], items_s: float, tmp_path: Path
) -> None:
    both = fly_both(name, tmp_path, seconds=seconds, system=virtual())
    assert both.facts["fell_behind"] == []
    assert_agrees(both, seconds, happened, items_s)


@pytest.mark.slow
def test_a_live_range_of_five_aircraft_repeats_exactly(tmp_path: Path) -> None:
    networks = {"a": virtual(), "b": virtual(), "c": virtual(seed=1)}
    flown = [fly_both("squares", tmp_path / name, seconds=12.0, system=system) for name, system in networks.items()]
    assert_repeats([both.live for both in flown])


@pytest.mark.slow
def test_a_live_range_of_one_aircraft_repeats_exactly(tmp_path: Path) -> None:
    scenario = load_text(BRIEF, overrides=["duration_s=2"])
    networks = {"a": virtual(), "b": virtual(), "c": virtual(seed=1)}
    assert_repeats(
        [fly_virtual(prepared(scenario, tmp_path / name, system=system)) for name, system in networks.items()]
    )


def test_a_flight_of_one_aircraft_agrees(tmp_path: Path) -> None:
    scenario = load_text(BRIEF)
    live = fly_virtual(prepared(scenario, tmp_path / "live", system=virtual()))
    found = agreement(live, fly(scenario, tmp_path / "virtual", report=False), TOLERANCE_S)
    assert found.until_s == pytest.approx(scenario.duration_s, abs=TOLERANCE_S)
    assert found.outcomes == {}
    assert [odd for odd in found.odd if odd.kind not in RACES] == []
    assert max(way.off_m for way in found.ways.values()) <= 1.0
    for kind in ("event.takeoff", "event.item_reached"):
        assert found.kinds[kind].found >= 1, kind
    reached = found.kinds["event.item_reached"]
    assert max(abs(reached.least_s), abs(reached.most_s)) < 0.5


def assert_repeats(lives: Sequence[RunRecord]) -> None:
    """Two on the same network record the same; another's delays make other times, and the same flights."""
    digests = [live.manifest["digests"] for live in lives]
    assert digests[0] == digests[1]
    assert digests[0]["frames"] != digests[2]["frames"]
