"""Agreement of live ranges with runs in virtual time: shipped scenarios, the live range's transports in memory.

`test_live_range` has one on sockets; `live_agrees` flies all of them in real time, to their ends.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.scenario.shipped import SHIPPED
from tests.integration.live_agrees import FLIGHTS, TOLERANCE_S, Both, fly_both, virtual

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


@pytest.mark.parametrize(
    ("name", "seconds", "happened", "items_s"),
    [
        ("squares", 24.0, SQUARES, 0.5),
        ("head-on", 44.0, HEAD_ON, 0.5),
        (
            "gnss-drift",
            80.0,
            {"event.item_reached": 1, "event.attack_start": 1, "event.collision": 1, "event.crash": 1},
            1.0,
        ),
        pytest.param("squares", 60.0, SQUARES | {"event.landed": 5}, 0.5, marks=pytest.mark.slow),
        pytest.param("crossing", 140.0, {"event.takeoff": 3, "event.landed": 3}, 0.1, marks=pytest.mark.slow),
        pytest.param("wind", 160.0, {"event.takeoff": 2, "event.landed": 2}, 0.1, marks=pytest.mark.slow),
        pytest.param("survey", 185.0, {"event.takeoff": 1, "event.landed": 1}, 0.1, marks=pytest.mark.slow),
        pytest.param("rid-spoofing", 155.0, {"event.takeoff": 2, "event.attack_start": 1}, 1.0, marks=pytest.mark.slow),
    ],
)
def test_the_same_happens_within_the_tolerance(
    name: str, seconds: float, happened: dict[str, int], items_s: float, tmp_path: Path
) -> None:
    both = fly_both(name, tmp_path, seconds=seconds, system=virtual())
    assert both.facts["fell_behind"] == []
    assert_agrees(both, seconds, happened, items_s)


def test_a_live_range_in_virtual_time_repeats_exactly(tmp_path: Path) -> None:
    """Two on the same network record the same; another's delays make other times, and the same flights."""
    first = fly_both("squares", tmp_path / "a", seconds=12.0, system=virtual())
    second = fly_both("squares", tmp_path / "b", seconds=12.0, system=virtual())
    third = fly_both("squares", tmp_path / "c", seconds=12.0, system=virtual(seed=1))
    digests = [both.live.manifest["digests"] for both in (first, second, third)]
    assert digests[0] == digests[1]
    assert digests[0]["frames"] != digests[2]["frames"]
