from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from skyrange.figures.maps import draw_mark
from skyrange.metrics.paths import deviations_m
from skyrange.metrics.safety import (
    Mishap,
    describe_mishap,
    distinct_mishaps,
    drawing_order,
    find_mishaps,
    first_mishaps,
    mishap_kind,
)
from skyrange.metrics.time_series import EMPTY_TRACK, RecordedNote, Track, Vehicle

S = 1_000_000_000
TRACK = Track(np.array([0, 10 * S]), np.array([[0.0, 0.0, 0.0], [100.0, 50.0, 20.0]]), np.zeros(2))


def event(
    kind: str, about: str = "blue/b1", time_s: float = 5.0, more: dict[str, Any] | None = None, **data: Any
) -> RecordedNote:
    return RecordedNote(int(time_s * S), kind, about, "world", data | (more or {}))


def test_what_alarms_and_what_does_not() -> None:
    assert mishap_kind(event("event.collision")) == "collision"
    assert mishap_kind(event("event.crash")) == "crash"
    assert mishap_kind(event("event.fence_breach")) == "breach"
    assert mishap_kind(event("event.mode", reason="gcs_failsafe")) == "failsafe"
    assert mishap_kind(event("event.mode", reason="fence_breached")) == "failsafe"
    for calm in ("gcs_command", "mission_end", ""):
        assert mishap_kind(event("event.mode", reason=calm)) == ""
    assert mishap_kind(event("event.contact")) == ""


def test_marks_stand_where_the_aircraft_truly_was_in_time_order() -> None:
    events = [
        event("event.crash", time_s=9.0),
        event("event.mode", mode="RTL", reason="battery_failsafe", time_s=2.5),
        event("event.collision", more={"with": "green/g1", "speed_mps": 9.87}),
        event("event.crash", about="green/g1"),
        event("event.takeoff"),
    ]
    found = find_mishaps(events, {"blue/b1": TRACK, "green/g1": EMPTY_TRACK})
    assert [mark.kind for mark in found] == ["failsafe", "collision", "crash"]
    assert np.array([mark.enu_m for mark in found]) == pytest.approx(
        np.array([(25, 12.5, 5), (50, 25, 10), (90, 45, 18)])
    )
    assert [mark.description for mark in found] == [
        "blue/b1: RTL for battery failsafe, 2.5 s",
        "blue/b1: collision with green/g1 at 9.9 m/s, 5.0 s",
        "blue/b1: crash, 9.0 s",
    ]


def test_a_collision_is_told_once_and_says_how_hard_it_was() -> None:
    first = event("event.collision", more={"with": "green/g1", "speed_mps": 10.03, "energy_j": 37.7})
    events = [
        first,
        event("event.collision", about="green/g1", more={"with": "blue/b1", "speed_mps": 10.03, "energy_j": 37.7}),
        event("event.crash", time_s=8.0, speed_mps=15.96),
        event("event.landed", time_s=8.0),
        event("event.collision", time_s=9.0, more={"with": "green/g1"}),
        event("event.collision", time_s=9.0, more={"with": "building:3"}),
    ]
    assert [describe_mishap(row) for row in distinct_mishaps(events)] == [
        "blue/b1: collision with green/g1 at 10.0 m/s and 38 J, 5.0 s",
        "blue/b1: crash at 16.0 m/s, 8.0 s",
        "blue/b1: collision with green/g1, 9.0 s",
        "blue/b1: collision with building:3, 9.0 s",
    ]


def test_what_undid_a_flight_is_its_first_collision_or_crash() -> None:
    events = [
        event("event.mode", mode="RTL", reason="gcs_failsafe", time_s=1.0),
        event("event.crash", time_s=8.0),
        event("event.collision", more={"with": "green/g1"}),
        event("event.mode", about="green/g1", mode="RTL", reason="gcs_failsafe"),
    ]
    assert first_mishaps(events) == {"blue/b1": "collision with green/g1, 5.0 s"}


def test_a_failsafe_does_not_cover_a_crash() -> None:
    kinds = ("crash", "failsafe", "collision", "breach")
    found = [Mishap(time, "a/b", kind, (0.0, 0.0, 0.0), "") for time, kind in enumerate(kinds)]
    assert [mark.kind for mark in drawing_order(found)] == ["failsafe", "breach", "crash", "collision"]


def written(mark: Mishap, x: float, y: float) -> str:
    return ElementTree.tostring(draw_mark(mark, x, y), encoding="unicode")


def test_a_mark_is_drawn_with_its_words_escaped() -> None:
    svg = written(Mishap(0, "a/b", "collision", (0.0, 0.0, 0.0), "a/b: <&>"), 12.34, 5.0)
    assert "translate(12.3 5)" in svg
    assert "&lt;&amp;&gt;" in svg
    assert written(Mishap(0, "a/b", "failsafe", (0.0, 0.0, 0.0), ""), 0, 0).count("M0 -7") == 2


def test_deviation_is_the_distance_from_the_line_through_home_and_waypoints() -> None:
    vehicle = Vehicle("blue/b1", "blue", "builtin", "iris", "path", (0.0, 0.0, 0.0))
    enu_m = np.array([[0, 0, 0.1], [0, 0, 30], [50, 3, 30], [104, -3, 28], [100, 40, 5], [100, 50, 0.2]], dtype=float)
    track = Track(np.arange(6) * S, enu_m, np.zeros(6))
    waypoints = np.array([[100.0, 0.0, 30.0], [100.0, 50.0, 30.0]])
    times_ns, away_m = deviations_m([vehicle], {vehicle.id: track}, {vehicle.id: waypoints})[vehicle.id]
    assert times_ns.tolist() == [1 * S, 2 * S, 3 * S, 4 * S]  # in the air
    assert away_m == pytest.approx([0, 3, 5, 0])
    assert deviations_m([vehicle], {vehicle.id: track}, {}) == {}
    assert deviations_m([vehicle], {vehicle.id: EMPTY_TRACK}, {vehicle.id: waypoints}) == {}
