"""What happens in the shipped scenarios, in which order: a changed digest lands with its explanation in the commit.

Of all scenarios only the `events` digest is pinned, which holds kinds and their order per vehicle, and no times. All
three digests of one scenario are: they are the same on every machine (`tools/compare_platforms.py`).
"""

from __future__ import annotations

import pytest

from skyrange.scenario.shipped import SHIPPED
from tests.catalogue import draw
from tests.flights import shared_run

EVENTS = {
    "chain": "3eebf910faa0bed6f397499af57a25f5",
    "city-fleet": "8445bb9deaec5b9568cc62e80b5370e3",
    "corridor-rush": "76c042c270d1da220309b01f82453038",
    "crossing": "2145c6e2ace0e2a696e7242279bfc21c",
    "emergency-landing": "13df949627d10a01707d25499210d869",
    "falsified-log": "709805673ba7cfd87307d589f73ccc7b",
    "gcs-flood": "ae53ccfa45d80dc0d72c6d8ef497c7d0",
    "gnss-drift": "ba5dd4ec3e7d9d9822a4ed97f89450ae",
    "gnss-pull-off": "a9a4c6098b5ccc95a6f90f3b16498fef",
    "head-on": "9189e8a79e36527fdae280a6245b710f",
    "hijack": "d48a15bf59f0fa6a2485906c5cf235d1",
    "insider": "8a593c45611742238dc1ff893fd9b510",
    "jam-then-spoof": "840c5351019a57006c3fe59c696e71ef",
    "jammed-corridor": "b80ce8aa6bcde02eabd5468fa8210116",
    "mitm-mission": "f02e0210c25681681913428654f0368a",
    "rid-city": "60a552feb571571da7c65e2a2ec939ea",
    "rid-spoofing": "6c114192b4d74a2b0dfe80c61702d1ba",
    "squares": "251f547cda3ae7a47c8e499da8c9c776",
    "survey": "5910fd9e32396594720b1e73f215d556",
    "unsigned-ghost": "db6df99cb7e55ff40b16402903b75ef7",
    "wind": "2898e76c3ee8c572c45ebb10544036ce",
}
ENDS = {name: {"complete"} for name in EVENTS} | {
    "emergency-landing": {"failed"},
    "gcs-flood": {"complete", "failed"},
    "gnss-drift": {"failed"},
    "head-on": {"failed", "unfinished"},
    "hijack": {"complete", "failed"},
    "insider": {"complete", "unfinished"},
    "jam-then-spoof": {"complete", "failed"},
}
"""How the mission of every aircraft ends."""


def test_frames_and_truth_are_the_same_on_every_machine() -> None:
    assert shared_run("squares").manifest["digests"]["fingerprint"] == "a013377cbeda7b5db86b984a50809d92"


def test_every_shipped_scenario_is_pinned() -> None:
    assert set(EVENTS) == set(SHIPPED)


SHORT = {
    "city-fleet": (("operators.*.fleets.*.count=1", "duration_s=120"), "bed5ed31f256a6b6a82ef0f2a5a9ab6e"),
    "corridor-rush": (("duration_s=75", "operators.*.fleets.*.count=3"), "935683e0ebab6436c7ccbe2a328285cb"),
    "falsified-log": (("duration_s=75",), "4233776c4434cb9c93c35ca32d4fee5b"),
    "gcs-flood": (("duration_s=80",), "4a1383171731b24842ebeadee3d672ea"),
    "gnss-pull-off": (("duration_s=70",), "83365de0758f693061e0b510036a5e7a"),
    "hijack": (("duration_s=70",), "2d50d0b95dd008982f473307016e1f94"),
    "insider": (("duration_s=60",), "12b9c8a6f1531c95580af30b254683f1"),
    "jam-then-spoof": (("duration_s=44",), "c23588735c03e26031c4c7bbf43e7542"),
    "jammed-corridor": (("duration_s=60",), "b7214c47219228e537934445ed749678"),
    "mitm-mission": (("duration_s=60",), "07ecdb66f8cfb74e6ba061770a7fae22"),
    "rid-city": (("duration_s=45", "operators.*.fleets.*.count=2"), "596d1492f642d9d9d6f7103fc610e087"),
    "rid-spoofing": (("duration_s=60",), "b2bc788cfa3173c608e82bacf779df2e"),
    "survey": (("duration_s=70",), "acc4b358c41da5d71d745b63ca34026d"),
    "unsigned-ghost": (("duration_s=60",), "b97111e20e223b7844cb2306de53740a"),
    "wind": (("duration_s=60",), "77c354b64b3c7fd34b6d2dfdbfba780a"),
}
"""Changes that shorten the flights which no other fast test reads, and the digests of what then happens."""


MANY = {"city-fleet", "corridor-rush", "rid-city"}
"""Flights of many aircraft, of which one is flown whole by a commit."""

FLOWN = (set(EVENTS) - MANY) | set(draw(sorted(MANY)))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=(pytest.mark.slow,) * (name in SHORT)) for name in sorted(FLOWN)]
)
def test_events_are_what_they_were(name: str) -> None:
    record = shared_run(name)
    assert {outcome["state"] for outcome in record.outcomes.values()} == ENDS[name]
    assert record.manifest["digests"]["events"] == EVENTS[name]


@pytest.mark.catalogue
@pytest.mark.parametrize("name", sorted(SHORT))
def test_events_of_a_shorter_flight_are_what_they_were(name: str) -> None:
    changes, events = SHORT[name]
    assert shared_run(name, *changes).manifest["digests"]["events"] == events
