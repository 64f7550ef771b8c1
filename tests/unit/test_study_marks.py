from __future__ import annotations

import numpy as np
import pytest

from skyrange.study.deviation import deviations_m
from skyrange.study.marks import Mark, alarming, drawn, marks
from skyrange.study.series import EMPTY_TRACK, Happening, Track, Vehicle

S = 1_000_000_000
TRACK = Track(np.array([0, 10 * S]), np.array([[0.0, 0.0, 0.0], [100.0, 50.0, 20.0]]), np.zeros(2))


def event(kind: str, about: str = "blue/b1", time_s: float = 5.0, **data) -> Happening:
    return Happening(int(time_s * S), kind, about, "world", data)


def test_what_alarms_and_what_does_not():
    assert alarming(event("event.collision")) == "collision"
    assert alarming(event("event.crash")) == "crash"
    assert alarming(event("event.fence_breach")) == "breach"
    assert alarming(event("event.mode", reason="gcs_failsafe")) == "failsafe"
    assert alarming(event("event.mode", reason="fence_breached")) == "failsafe"
    for calm in ("gcs_command", "mission_end", ""):
        assert alarming(event("event.mode", reason=calm)) == ""
    assert alarming(event("event.contact")) == ""


def test_marks_stand_where_the_aircraft_truly_was_in_time_order():
    events = [
        event("event.crash", time_s=9.0),
        event("event.mode", mode="RTL", reason="battery_failsafe", time_s=2.5),
        event("event.collision", **{"with": "green/g1", "speed_mps": 9.87}),
        event("event.crash", about="green/g1"),
        event("event.takeoff"),
    ]
    found = marks(events, {"blue/b1": TRACK, "green/g1": EMPTY_TRACK})
    assert [(mark.kind, mark.enu_m) for mark in found] == [
        ("failsafe", pytest.approx((25, 12.5, 5))),
        ("collision", pytest.approx((50, 25, 10))),
        ("crash", pytest.approx((90, 45, 18))),
    ]
    assert [mark.words for mark in found] == [
        "blue/b1: RTL for battery failsafe, 2.5 s",
        "blue/b1: collision with green/g1 at 9.9 m/s, 5.0 s",
        "blue/b1: crash, 9.0 s",
    ]


def test_a_mark_is_drawn_with_its_words_escaped():
    svg = drawn(Mark(0, "a/b", "collision", (0.0, 0.0, 0.0), "a/b: <&>"), 12.34, 5.0)
    assert "translate(12.3 5)" in svg
    assert "&lt;&amp;&gt;" in svg
    assert drawn(Mark(0, "a/b", "failsafe", (0.0, 0.0, 0.0), ""), 0, 0).count("M0 -7") == 2


def test_deviation_is_the_distance_from_the_line_through_home_and_waypoints():
    vehicle = Vehicle("blue/b1", "blue", "builtin", "iris", "path", (0.0, 0.0, 0.0))
    enu_m = np.array([[0, 0, 0.1], [0, 0, 30], [50, 3, 30], [104, -3, 28], [100, 40, 5], [100, 50, 0.2]], dtype=float)
    track = Track(np.arange(6) * S, enu_m, np.zeros(6))
    waypoints = np.array([[100.0, 0.0, 30.0], [100.0, 50.0, 30.0]])
    times_ns, away_m = deviations_m([vehicle], {vehicle.id: track}, {vehicle.id: waypoints})[vehicle.id]
    assert times_ns.tolist() == [1 * S, 2 * S, 3 * S, 4 * S]  # in the air
    assert away_m == pytest.approx([0, 3, 5, 0])
    assert deviations_m([vehicle], {vehicle.id: track}, {}) == {}
    assert deviations_m([vehicle], {vehicle.id: EMPTY_TRACK}, {vehicle.id: waypoints}) == {}
