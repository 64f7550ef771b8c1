"""A lost ground station: ArduCopter/events.cpp `failsafe_gcs_check`, `failsafe_gcs_on_event`, `…_off_event`."""

from __future__ import annotations

import pytest

from skyrange.vehicle.builtin.modes import Mode
from tests.integration.flight_harness import Range, land, rtl, takeoff, waypoint
from tests.integration.hovering import V, beat, hovering, modes, put, standing, texts, when

pytestmark = pytest.mark.rotating

WARNING = 4


def lose(r: Range, seconds: float = 7.0) -> float:
    """One heartbeat, then none; when the heartbeat came."""
    beat(r)
    start = r.seconds
    r.run(seconds)
    return start


def test_returns_5_s_after_the_last_heartbeat_and_says_when_it_is_back() -> None:
    r = hovering(FS_GCS_ENABLE=1)
    start = lose(r)
    assert texts(r, start) == [(WARNING, "GCS Failsafe")]
    assert modes(r, start) == [("RTL", "gcs_failsafe")]
    assert when(r, "GCS Failsafe") - start == pytest.approx(5.0, abs=0.12)  # a check every 0.1 s
    back = r.seconds
    beat(r)
    r.run(0.2)
    assert texts(r, back) == [(WARNING, "GCS Failsafe Cleared")]
    assert modes(r, back) == []  # the mode stays
    r.run(6.0)
    assert texts(r, back + 0.2) == [(WARNING, "GCS Failsafe")]  # and it may be lost again


def test_disabled_by_default() -> None:
    r = hovering()
    start = lose(r, 20.0)
    assert texts(r, start) == []
    assert modes(r, start) == []


def test_never_before_the_first_heartbeat_and_of_its_own_station_only() -> None:
    r = hovering(FS_GCS_ENABLE=1)
    start = r.seconds
    r.run(8.0)
    assert texts(r, start) == []
    beat(r, system=254)
    r.run(8.0)
    assert texts(r, start) == []
    put(r, "SYSID_MYGCS", 254)
    beat(r, system=254)
    for _ in range(8):
        beat(r)  # 255 does not count now
        r.run(1.0)
    assert modes(r, start) == [("RTL", "gcs_failsafe")]


def test_the_time_out_is_a_parameter() -> None:
    r = hovering(FS_GCS_ENABLE=1, FS_GCS_TIMEOUT=2)
    start = lose(r, 3.0)
    assert when(r, "GCS Failsafe") - start == pytest.approx(2.0, abs=0.12)


@pytest.mark.parametrize(
    ("value", "mode", "more"),
    [
        (2, "RTL", []),
        (3, "RTL", ["SmartRTL Unavailable, Trying RTL Mode"]),
        (4, "LAND", ["SmartRTL Unavailable, Using Land Mode"]),
        (5, "LAND", []),
        (
            6,
            "RTL",
            [
                "Unable to start landing sequence",
                "Mode change to AUTO RTL failed: No return path or ",
                "Trying RTL Mode",
            ],
        ),
        (7, "BRAKE", []),
    ],
)
def test_actions(value: int, mode: str, more: list[str]) -> None:
    r = hovering(FS_GCS_ENABLE=value)
    start = lose(r)
    assert [words for _, words in texts(r, start)] == ["GCS Failsafe", *more]
    assert modes(r, start) == [(mode, "gcs_failsafe")]


def test_landing_waits_four_seconds_and_then_comes_down() -> None:
    r = hovering(FS_GCS_ENABLE=5)
    lose(r, 8.9)  # 5.1 s to notice, LAND_WITH_DELAY_MS 4 s
    assert r.positions()[0, 2] == pytest.approx(10.0, abs=0.2)
    r.run(2.0)
    assert r.positions()[0, 2] < 9.5
    r.run_until(r.has("event.disarmed"), 40.0)


@pytest.mark.parametrize(("options", "goes_on"), [(16, False), (2, True)])
def test_a_mission_goes_on_where_fs_options_says(options: int, goes_on: bool) -> None:
    r = hovering(FS_GCS_ENABLE=1, FS_OPTIONS=options)
    r.upload(V, [takeoff(10), waypoint(0, 200, 10), rtl()])
    assert r.mode(V, Mode.AUTO) == 0
    start = lose(r)
    if goes_on:
        assert texts(r, start)[-1] == (WARNING, "GCS Failsafe - Continuing Auto Mode")
        assert modes(r, start) == []
    else:
        assert modes(r, start) == [("RTL", "gcs_failsafe")]


def test_a_pilots_mode_goes_on_by_default_and_not_without_the_bit() -> None:
    # BRAKE is none of an autopilot's (mode.h ModeBrake::is_autopilot)
    for options, expected in ((16, "GCS Failsafe - Continuing Pilot Control"), (0, "GCS Failsafe")):
        r = hovering(FS_GCS_ENABLE=1, FS_OPTIONS=options)
        assert r.mode(V, Mode.BRAKE) == 0
        start = lose(r)
        assert texts(r, start) == [(WARNING, expected)]
        assert modes(r, start) == ([] if options else [("RTL", "gcs_failsafe")])


def test_landing_goes_on_where_fs_options_says() -> None:
    for options, expected in ((8, "GCS Failsafe - Continuing Landing"), (0, "GCS Failsafe")):
        r = hovering(FS_GCS_ENABLE=1, FS_OPTIONS=options)
        r.upload(V, [takeoff(10), land(0, 30)])
        assert r.mode(V, Mode.LAND) == 0
        start = lose(r)
        assert texts(r, start) == [(WARNING, expected)]
        assert modes(r, start) == ([] if options else [("RTL", "gcs_failsafe")])


def test_on_the_ground_armed_it_disarms_and_disarmed_it_only_says_so() -> None:
    r = standing(FS_GCS_ENABLE=1, DISARM_DELAY=0)
    r.mode(V, Mode.GUIDED)
    beat(r)
    r.arm(V)
    start = lose(r)
    assert (WARNING, "GCS Failsafe - Disarming") in texts(r, start)
    assert [n.data["reason"] for n in r.events("event.disarmed")] == ["gcs_failsafe"]
    assert r.arm(V) == 4  # until it is back
    assert (2, "Arm: GCS failsafe on") in texts(r, start)
    beat(r)
    r.run(0.2)
    assert r.arm(V) == 0
    r = standing(FS_GCS_ENABLE=1)
    start = lose(r)
    assert texts(r, start) == [(WARNING, "GCS Failsafe"), (2, "PreArm: GCS failsafe on")]
