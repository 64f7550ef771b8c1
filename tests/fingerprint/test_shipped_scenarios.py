"""What happens in the shipped scenarios, in which order: a changed digest lands with its explanation in the commit.

Only the `events` digest is pinned: it holds kinds and their order per vehicle, no times, and so is the
same on every machine. The exact digests of frames and truth are compared between runs, not between machines.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.scenario.shipped import SHIPPED, load
from skyrange.study.runs import fly

EVENTS = {
    "chain": "3eebf910faa0bed6f397499af57a25f5",
    "city-fleet": "8445bb9deaec5b9568cc62e80b5370e3",
    "crossing": "2145c6e2ace0e2a696e7242279bfc21c",
    "gnss-drift": "ba5dd4ec3e7d9d9822a4ed97f89450ae",
    "head-on": "9189e8a79e36527fdae280a6245b710f",
    "rid-city": "d5b61b4fd4f5277c9428c1d866d88760",
    "rid-spoofing": "6c114192b4d74a2b0dfe80c61702d1ba",
    "squares": "251f547cda3ae7a47c8e499da8c9c776",
    "survey": "5910fd9e32396594720b1e73f215d556",
    "wind": "2898e76c3ee8c572c45ebb10544036ce",
}
ENDS = {name: {"complete"} for name in EVENTS} | {"gnss-drift": {"failed"}, "head-on": {"failed", "unfinished"}}
"""How the mission of every aircraft ends."""


def test_every_shipped_scenario_is_pinned() -> None:
    assert set(EVENTS) == set(SHIPPED)


@pytest.mark.parametrize("name", sorted(EVENTS))
def test_events_are_what_they_were(name: str, tmp_path: Path) -> None:
    record = fly(load(name), tmp_path / "run", report=False)
    assert {outcome["state"] for outcome in record.outcomes.values()} == ENDS[name]
    assert record.manifest["digests"]["events"] == EVENTS[name]
