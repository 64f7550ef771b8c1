"""What compromised stations, companions and plans, and forged approvals, make of a flight of two squares."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.codec.mavlink.frames import decode
from skyrange.contracts.frames import Frame
from skyrange.contracts.plugins.registry import NoParams
from skyrange.core.time import NS_PER_S, Time, from_seconds
from skyrange.scenario.model.scenario import Scenario, Start, Vehicle, square
from skyrange.testing.checks.attacks import AttackCase, Flight, two_squares
from skyrange.utm.approval_service import policy_plugin
from skyrange.utm.contract import ApprovalDecision, OperationalIntent
from tests.conformance.test_attacks_companion import encounter
from tests.conformance.test_attacks_telemetry import signed_squares
from tests.registered_kinds import registered

pytestmark = pytest.mark.catalogue

GUIDED = AttackPlugin.find("mavlink.guided")
FORGED_DECISION = AttackPlugin.find("approval.forged_decision")
INSIDER = AttackPlugin.find("ground.insider")
PLAN_FILE = AttackPlugin.find("ground.plan_file")
FALSE_AVOIDANCE = AttackPlugin.find("companion.false_avoidance")
NO_AVOIDANCE = AttackPlugin.find("companion.no_avoidance")
TAKEOVER = AttackPlugin.find("companion.takeover")

START_S = 9.0
"""When the squares are flown, after the take-off."""
LINK = "gcs:blue/b1"


def flown(
    kind: AttackPlugin,
    params: dict[str, Any],
    duration_s: float,
    start_s: float = START_S,
    scenario: Callable[[float], Scenario] = signed_squares,
    **how: bool,
) -> Flight:
    times = from_seconds(start_s), from_seconds(duration_s)
    return AttackCase(kind, params, scenario(duration_s), *times, True).fly(**how)


def noted(flight: Flight, kind: str, about: str = "blue/b1") -> list[str]:
    return [row[4] for row in flight.notes() if row[2] == kind and row[3] == about]


def track(flight: Flight, row: int = 0) -> list[tuple[float, float, float]]:
    names = ("east_m", "north_m", "up_m")
    return [tuple(float(t.columns[name][row]) for name in names) for t in flight.seen.truth]  # type: ignore[misc]


def arrived(flight: Flight, direction: str, *numbers: int, since_s: float = START_S) -> list[Frame]:
    """What was delivered on the link of the first aircraft, in order."""
    found = [
        f for f in flight.seen.frames if f.link == LINK and f.direction == direction and str(f.fate) == "delivered"
    ]
    found = [f for f in found if f.sent_ns >= since_s * NS_PER_S and (not numbers or message_id(f.payload) in numbers)]
    return sorted(found, key=lambda f: (f.arrived_ns, f.payload[4]))


def one_fleet(duration_s: float) -> Scenario:
    """Two squares of one operator, with signed links."""
    squares = signed_squares(duration_s)
    fleet = tuple(
        Vehicle(id=f"b{n}", system_id=n, start=Start(east_m=40.0 * (n - 1)), plan=square(10, 8)) for n in (1, 2)
    )
    blue = squares.operators[0].model_copy(update={"vehicles": fleet})
    return squares.model_copy(update={"operators": (blue,)})


def test_signing_stops_an_injected_hijack_and_no_insider() -> None:
    """The injecting node has no key; the insider is the station, and leads the whole fleet to one place."""
    outside = flown(GUIDED, {"vehicles": ["blue/b1"], "track": [[20, 20, 10]]}, 14.0, scenario=one_fleet)
    assert "AUTO" in noted(outside, "event.mode")[-1]
    assert noted(outside, "event.signature_refused")
    inside = flown(INSIDER, {"operator": "blue", "at": [20, 20, 10]}, 24.0, scenario=one_fleet)
    for row, vehicle in enumerate(("blue/b1", "blue/b2")):
        assert math.dist(track(inside, row)[-1][:2], (20, 20)) < 5.0, "there, or fallen there after they collided"
        assert not noted(inside, "event.signature_refused", vehicle)
        assert not noted(inside, "decision.signature_refused", vehicle)


def test_the_displays_of_the_insider_show_the_plan() -> None:
    flight = flown(INSIDER, {"operator": "blue", "at": [60, 60, 30]}, 20.0)
    assert math.dist(track(flight)[-1], (0, 0, 8)) > 35.0
    origin = signed_squares(1.0).origin.datum
    shown = arrived(flight, "rev", mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mav.MAVLINK_MSG_ID_HEARTBEAT)
    for frame in [one for one in shown if one.arrived_ns < 20 * NS_PER_S]:
        message = decode(frame.payload)
        if message.get_msgId() == mav.MAVLINK_MSG_ID_HEARTBEAT:
            assert message.custom_mode == mav.COPTER_MODE_AUTO
        else:
            east, north = origin.enu_of(message.lat * 1e-7, message.lon * 1e-7)
            assert -3 < east < 13
            assert -3 < north < 13
            assert message.relative_alt < 10_000
    assert not noted(flight, "decision.link_lost")


def test_the_insider_sends_in_the_station_own_stream() -> None:
    """One sender, one link id of signatures, no number missing or twice, and timestamps that increase."""
    frames = arrived(flown(INSIDER, {"operator": "blue", "at": [60, 60, 30]}, 16.0), "fwd")
    assert {frame.payload[5:7] for frame in frames} == {bytes((255, 190))}
    assert {frame.payload[-13] for frame in frames} == {0}
    assert len(frames) > 15
    numbers = [frame.payload[4] for frame in frames]
    assert all((later - one) % 256 == 1 for one, later in pairwise(numbers))
    stamps = [int.from_bytes(frame.payload[-12:-6], "little") for frame in frames]
    assert all(one < later for one, later in pairwise(stamps))


def guided_square(duration_s: float) -> Scenario:
    """The square of the first aircraft as targets of its ground station."""
    squares = signed_squares(duration_s)
    blue = squares.operators[0]
    plan = blue.vehicles[0].plan.model_copy(update={"mode": "guided"})
    blue = blue.model_copy(update={"vehicles": (blue.vehicles[0].model_copy(update={"plan": plan}),)})
    return squares.model_copy(update={"operators": (blue, *squares.operators[1:])})


def test_the_insider_answers_the_orders_of_the_operator() -> None:
    """The station sees its targets reached and orders a return: that is acknowledged, and the aircraft stays."""
    flight = flown(INSIDER, {"operator": "blue", "at": [30, 30, 20]}, 50.0, scenario=guided_square)
    assert noted(flight, "decision.plan_done")
    assert not noted(flight, "decision.gave_up")
    assert "GUIDED" in noted(flight, "event.mode")[-1]
    assert math.dist(track(flight)[-1], (30, 30, 20)) < 5.0


def test_a_companion_takes_over_and_holds_back_the_operator() -> None:
    params = {"vehicles": ["blue/b1"], "track": [[60, 0, 10]]}
    live, sham = (flown(TAKEOVER, params, 26.0, scenario=guided_square, sham=each) for each in (False, True))
    assert math.dist(track(live)[-1], (60, 0, 10)) < 5.0
    assert max(east for east, _, _ in track(sham)) < 15.0
    assert not noted(live, "event.signature_refused")
    sent = arrived(live, "fwd", mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT)
    assert sent, "the station still commands"


def test_false_avoidance_leaves_the_mission_and_comes_back() -> None:
    live = flown(FALSE_AVOIDANCE, {"vehicles": ["blue/b1"], "every_s": 60, "hold_s": 4}, 20.0)
    modes = ["GUIDED" if "GUIDED" in row else "AUTO" for row in noted(live, "event.mode")[-2:]]
    assert modes == ["GUIDED", "AUTO"]
    assert max(math.hypot(east - 5, north - 5) for east, north, _ in track(live)) > 12.0


def test_who_does_not_avoid_collides() -> None:
    params = {"vehicles": ["blue/b1", "green/g1"]}
    live, sham = (flown(NO_AVOIDANCE, params, 36.0, 5.0, encounter, sham=each) for each in (False, True))

    def closest_m(flight: Flight) -> float:
        return min(math.dist(one, two) for one, two in zip(track(flight, 0), track(flight, 1), strict=True))

    assert closest_m(live) < 3.0
    assert closest_m(sham) > 5.0
    assert noted(live, "decision.avoid"), "the companion decides to avoid"


def test_all_agree_on_an_altered_plan() -> None:
    flight = flown(PLAN_FILE, {"vehicles": ["blue/b1"], "offset_m": [40, 0, 0]}, 25.0, 0.0)
    assert noted(flight, "decision.verified")
    assert noted(flight, "decision.approval_accepted")
    assert max(east for east, _, _ in track(flight)) > 35.0
    (request, *_) = [f for f in flight.seen.frames if f.link == "approval:blue" and f.parent is not None]
    assert b'"operator":"blue"' in request.payload


def heights(flight: Flight, since_s: float) -> list[float]:
    """Heights of the first aircraft from a time on, in metres."""
    ticks = [t for t in flight.seen.truth if t.time_ns >= since_s * NS_PER_S]
    return [float(t.columns["up_m"][0]) for t in ticks]


def test_feet_are_flown_as_metres() -> None:
    assert max(heights(flown(PLAN_FILE, {"vehicles": ["blue/b1"], "form": "scale"}, 30.0, 0.0), 0)) > 20.0


def test_heights_above_home_are_flown_as_heights_above_sea_level() -> None:
    """The square is 8 m above ground, which is 5 m above sea level."""

    def on_a_hill(duration_s: float) -> Scenario:
        squares = signed_squares(duration_s)
        return squares.model_copy(update={"origin": squares.origin.model_copy(update={"alt_msl_m": 5.0})})

    params = {"vehicles": ["blue/b1"], "form": "sea_level"}
    live, sham = (flown(PLAN_FILE, params, 18.0, 0.0, on_a_hill, sham=each) for each in (False, True))
    assert min(heights(live, 14.0)) < 5.0
    assert min(heights(sham, 14.0)) > 6.0


@pytest.mark.slow
def test_an_endless_plan_does_not_land() -> None:
    params = {"vehicles": ["blue/b1"], "form": "endless"}
    live, sham = (flown(PLAN_FILE, params, 54.0, 0.0, sham=each) for each in (False, True))
    assert noted(sham, "event.disarmed")
    assert not noted(live, "event.disarmed")
    assert min(heights(live, 20.0)) > 5.0


@pytest.fixture
def _rejecting() -> Iterator[None]:
    """An approver that rejects every flight."""

    class RejectAll:
        def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
            return ApprovalDecision(False, "closed")

        def end(self, now: Time, intent: str) -> None:
            """Of a flight that it has rejected."""

    with registered(("reject-all", policy_plugin(NoParams, lambda params: RejectAll(), "Rejects every flight plan."))):
        yield


def test_a_forged_rejection_keeps_an_approved_flight_on_the_ground() -> None:
    flight = flown(FORGED_DECISION, {"vehicles": ["blue/b1"]}, 12.0, 0.0, two_squares)
    assert noted(flight, "decision.approval_accepted")
    assert noted(flight, "decision.rejected")
    assert max(up for _, _, up in track(flight)) < 0.5
    assert max(up for _, _, up in track(flight, 1)) > 5.0


@pytest.mark.usefixtures("_rejecting")
def test_a_forged_acceptance_makes_a_rejected_flight_depart() -> None:
    def rejected(duration_s: float) -> Scenario:
        squares = two_squares(duration_s)
        operators = tuple(one.model_copy(update={"approval": "reject-all"}) for one in squares.operators)
        return squares.model_copy(update={"operators": operators})

    params = {"vehicles": ["blue/b1"], "decision": "Accepted"}
    live, sham = (flown(FORGED_DECISION, params, 12.0, 0.0, rejected, sham=each) for each in (False, True))
    assert noted(live, "decision.approval_rejected")
    assert max(up for _, _, up in track(live)) > 5.0
    assert max(up for _, _, up in track(sham)) < 0.5
