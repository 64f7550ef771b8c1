"""A live range flies as the same scenario does in virtual time. `live_agrees` flies all of them, to their ends."""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.scenario.catalogue import SHIPPED
from tests.integration.live_agrees import FLIGHTS, TOLERANCE_S, fly_both
from tests.ports import OFFSET

pytestmark = pytest.mark.realtime


def test_all_that_is_shipped_is_flown_by_the_table() -> None:
    assert set(FLIGHTS) == set(SHIPPED)


@pytest.mark.parametrize(
    ("name", "seconds", "happened"),
    [
        ("squares", 24.0, {"event.takeoff": 5, "event.item_reached": 10}),
        ("head-on", 44.0, {"event.takeoff": 2, "event.collision": 2}),
    ],
)
def test_the_same_happens_within_the_tolerance(
    name: str, seconds: float, happened: dict[str, int], tmp_path: Path
) -> None:
    both = fly_both(name, tmp_path, OFFSET, seconds)
    if both.facts["fell_behind"]:
        pytest.skip(f"this machine did not hold real time: {both.facts['late_max_s']}")
    assert both.wrong == []
    assert both.found.until_s == pytest.approx(seconds, abs=TOLERANCE_S)
    for kind, least in happened.items():
        assert both.found.kinds[kind].found >= least, kind
    assert both.amount_s("event.item_reached") < 0.5
