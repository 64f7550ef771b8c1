"""Landings that ended missions: which touchdown counts, whatever the station says, and when."""

from __future__ import annotations

import pytest

from skyrange.core.time import from_seconds
from skyrange.metrics.safety import find_landings_s
from skyrange.metrics.time_series import RecordedNote


def notes(*rows: tuple[float, str]) -> list[RecordedNote]:
    return [RecordedNote(from_seconds(at_s), f"event.{kind}", "a/1", "world", {}, ()) for at_s, kind in rows]


def landed_s(events: list[RecordedNote], reported_s: float | None) -> float | None:
    return find_landings_s(events, {"a/1": {"state": "complete", "finished_s": reported_s}}).get("a/1")


FLIGHT = notes((1.0, "takeoff"), (17.1425, "contact"), (18.2, "landed"), (20.01, "disarmed"))
TWO = notes((1.0, "takeoff"), (17.14, "contact"), (30.0, "takeoff"), (47.3, "contact"))


@pytest.mark.parametrize(
    ("events", "reported_s", "expected_s"),
    [
        (FLIGHT, 22.0, 17.1425),
        (FLIGHT, 22.98, 17.1425),
        (TWO, 22.0, 17.14),  # it flew again after that mission
        (TWO, 50.0, 47.3),
        (FLIGHT, 5.0, 17.1425),  # reported in the air: somebody forged the report
        (TWO, 35.0, 47.3),
        (FLIGHT, None, None),  # never reported: unfinished
        (notes((1.0, "takeoff")), 9.0, None),  # never came down
        (notes((17.0, "contact"), (17.3, "contact")), 20.0, 17.3),  # a bounce of more than 5 cm
        (FLIGHT[::-1], 22.0, 17.1425),
    ],
)
def test_the_touchdown_that_ended_the_mission(
    events: list[RecordedNote], reported_s: float | None, expected_s: float | None
) -> None:
    assert landed_s(events, reported_s) == expected_s


def test_an_aircraft_has_its_own_touchdowns() -> None:
    outcomes = {"a/1": {"finished_s": 22.0}, "a/2": {"finished_s": 22.0}}
    assert find_landings_s(FLIGHT, outcomes) == {"a/1": 17.1425}
