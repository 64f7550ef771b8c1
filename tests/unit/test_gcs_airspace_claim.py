"""The ground station and an approval that tracks intents: alternatives, activation, leaving the volumes, and the
end."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_S, Time
from skyrange.core.volumes import contains
from skyrange.gcs.flight.airspace_claim import LATE_NS, REPORT_PAUSE_NS, ROUNDS, AirspaceClaim
from skyrange.gcs.flight.lifecycle import Flight
from skyrange.gcs.plan import plans
from skyrange.gcs.plan.plans import FlightPlan, altered
from skyrange.gcs.plan.routes import enu_points
from skyrange.gcs.plan.volumes import volumes
from skyrange.gcs.station import GroundStation
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.authority import Authority, AuthorityParams
from skyrange.utm.contract import Alternative, ApprovalDecision, OperationalIntent, Overruled, intent_id
from skyrange.utm.intent_states import EXCURSION_NS, RECOVERY_NS, IntentState
from tests.unit.fake_autopilot import EPOCH, ORIGIN, FakeAutopilot, Loop

HOME = (5.0, 5.0, 0.0)
S = IntentState


def square(kind: plans.Kind = "auto", side_m: float = 5.0) -> FlightPlan:
    return plans.square(ORIGIN, HOME, side_m=side_m, alt_m=5, kind=kind)


class Watched(Authority):
    """An authority that keeps what it was asked and what it said."""

    def __init__(self, **params: Any) -> None:
        super().__init__(AuthorityParams(**params))
        self.asked: list[tuple[Time, OperationalIntent, ApprovalDecision | None]] = []

    def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        decision = super().decide(now, request)
        self.asked.append((now, request, decision))
        return decision

    def end(self, now: Time, intent: str) -> None:
        super().end(now, intent)
        self.asked.append((now, OperationalIntent(intent, "", "", (), state=S.ENDED), None))

    def states(self, vehicle: str) -> list[IntentState]:
        return [intent.state for _, intent, _ in self.asked if intent.id == intent_id(vehicle)]


def loop(approver: Any, *departures_s: float, plan: FlightPlan | None = None, city: City | None = None) -> Loop:
    """Stations of one aircraft each, all from the same place."""
    names = [f"op{k}" for k in range(len(departures_s))]
    stations = [
        GroundStation(name, [Flight(f"{name}/a", 1, plan or square(), depart_s)], EPOCH, city=city)
        for name, depart_s in zip(names, departures_s, strict=True)
    ]
    service = FlightApproval(names, EPOCH, approver)
    return Loop(stations, {f"{name}/a": FakeAutopilot(1, HOME) for name in names}, service)


def outcome(run: Loop, number: int = 0) -> tuple[str, str]:
    found = run.stations[number].outcomes[f"op{number}/a"]
    return found.state, found.reason


def test_an_intent_is_asked_for_activated_and_ended() -> None:
    approver = Watched()
    run = loop(approver, 8.0).run(120)
    run.run(run.now / NS_PER_S + 1, stop=False)
    assert outcome(run) == ("complete", "")
    assert approver.states("op0/a") == [S.ACCEPTED, S.ACTIVATED, S.ENDED]
    activated_s = approver.asked[1][0] / NS_PER_S
    assert activated_s == pytest.approx(5.0, abs=0.1)
    assert approver.asked[0][1].volumes == approver.asked[1][1].volumes
    assert run.stations[0].bad_approvals == 0
    kinds = run.kinds("op0/a")
    order = [
        "decision.approved",
        "decision.prepared",
        "decision.activation_requested",
        "decision.activated",
        "decision.armed",
    ]
    assert sorted(order, key=kinds.index) == order


def test_a_rejected_flight_takes_the_alternative_and_no_two_that_are_accepted_overlap() -> None:
    approver = Watched()
    run = loop(approver, 8.0, 9.0, 10.0).run(400)
    assert [outcome(run, number) for number in range(3)] == [("complete", "")] * 3
    taken = [note.data for _, _, note in run.notes if note.kind == "decision.alternative_chosen"]
    changed = [data for data in taken if data["delay_s"] or data["climb_m"] or data["east_m"] or data["north_m"]]
    assert len(changed) >= 2
    heights = {max(item.z for item in run.aircraft[f"op{k}/a"].items[1:] if item.command == 16) for k in range(3)}
    climbs: set[Any] = {data["climb_m"] for data in taken if data["climb_m"]}
    assert heights == {5.0} | {5.0 + climb_m for climb_m in climbs}


def test_a_plan_that_would_come_near_walls_is_not_taken() -> None:
    roof = Building("roof", 200.0, shapely.box(-60.0, -60.0, 60.0, 60.0), base_m=12.0)
    approver = Watched()
    run = loop(approver, 8.0, 9.0, city=City([roof], "test")).run(400)
    assert outcome(run, 1) == ("complete", "")
    (taken,) = (note.data for _, _, note in run.notes if note.kind == "decision.alternative_chosen")
    assert taken["delay_s"] > 0  # type: ignore[operator]
    assert taken["climb_m"] == 0


class Never(Watched):
    """Rejects all, and offers what it rejects again."""

    def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        self.asked.append((now, request, None))
        return ApprovalDecision(False, "taken", (Alternative(request.volumes, NS_PER_S),))


def test_an_approval_that_never_accepts_is_given_up() -> None:
    approver = Never()
    run = loop(approver, 8.0).run(600)
    assert outcome(run) == ("failed", "approval rejected: taken")
    assert len(approver.asked) == ROUNDS


class Forgets(Watched):
    """Rejects the activation of what it has accepted."""

    def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        if request.state is S.ACTIVATED and S.ACTIVATED not in self.states(request.vehicle):
            self.asked.append((now, request, None))
            return ApprovalDecision(False, "taken", (Alternative(request.volumes, 20 * NS_PER_S),))
        return super().decide(now, request)


def test_a_rejected_activation_keeps_the_aircraft_on_the_ground_until_the_alternative_is_accepted() -> None:
    approver = Forgets()
    run = loop(approver, 8.0).run(200)
    assert outcome(run) == ("complete", "")
    assert approver.states("op0/a")[:4] == [S.ACCEPTED, S.ACTIVATED, S.ACCEPTED, S.ACTIVATED]
    departed = [at for at, _, note in run.notes if note.kind == "decision.departing"]
    assert departed == [28 * NS_PER_S]


def test_a_flight_that_is_late_claims_the_time_at_which_it_will_depart() -> None:
    approver = Watched()
    run = loop(approver, 1.0)
    run.aircraft["op0/a"].mute_until = 30 * NS_PER_S
    run.run(200)
    assert outcome(run) == ("complete", "")
    first, second = (intent.volumes[0].start_ns for _, intent, _ in approver.asked[:2])
    assert second - first > 25 * NS_PER_S


@pytest.mark.parametrize(("late_ns", "kept"), [(-1, True), (0, True), (LATE_NS, True), (LATE_NS + 1, False)])
def test_an_activation_keeps_the_accepted_volumes_until_the_flight_is_five_seconds_late(
    late_ns: Time, kept: bool
) -> None:
    flight, claim = Flight("op0/a", 1, square(), 8.0), AirspaceClaim(EPOCH, Chance(1))
    accepted = claim.request(flight, 0).intent
    activated = claim.activate(flight, 8 * NS_PER_S + late_ns).intent
    assert activated.state is S.ACTIVATED
    assert (activated.volumes == accepted.volumes) is kept


def test_an_approval_that_is_silent_at_activation_ends_the_flight_on_the_ground() -> None:
    run = loop(Watched(), 8.0).run(4)
    run.blocked.add("approval:op0")
    run.run(60)
    assert outcome(run) == ("failed", "approval: no answer after 6 requests")
    assert not run.aircraft["op0/a"].armed


def drifted(run: Loop, east_m: float, until_s: float) -> None:
    """Have the aircraft report that it is elsewhere."""
    autopilot = run.aircraft["op0/a"]
    while run.now < until_s * NS_PER_S:
        here = list(autopilot.position)
        autopilot.position = [here[0] + east_m, *here[1:]]
        run.step()
        autopilot.position = here


def test_an_aircraft_that_leaves_its_volumes_and_returns_is_reported() -> None:
    approver = Watched()
    run = loop(approver, 8.0, plan=square(side_m=100.0)).run(20)
    drifted(run, 40.0, 20.0 + EXCURSION_NS / NS_PER_S - 1.0)
    assert approver.states("op0/a") == [S.ACCEPTED, S.ACTIVATED]
    drifted(run, 40.0, 33.0)
    assert approver.states("op0/a")[2:] == [S.NONCONFORMING]
    _, intent, _ = approver.asked[-1]
    lat, lon = ORIGIN.geodetic_of(run.aircraft["op0/a"].position[0] + 40.0, run.aircraft["op0/a"].position[1])
    up_m = ORIGIN.ellipsoid_of(ORIGIN.alt_msl_m) + run.aircraft["op0/a"].position[2]
    assert contains(intent.volumes, run.now, lat, lon, up_m)
    run.run(36)
    assert approver.states("op0/a")[3:] == [S.ACTIVATED]
    run.run(300)
    assert outcome(run) == ("complete", "")


def test_an_aircraft_that_does_not_return_is_contingent() -> None:
    approver = Watched()
    run = loop(approver, 8.0, plan=square(side_m=100.0)).run(20)
    drifted(run, 40.0, 20.0 + (EXCURSION_NS + RECOVERY_NS) / NS_PER_S + 2.0)
    assert approver.states("op0/a")[2:] == [S.NONCONFORMING, S.CONTINGENT]


def test_an_aircraft_whose_excursion_the_approval_refuses_flies_home_and_does_not_report_it_again() -> None:
    class Refuses(Watched):
        def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
            if request.state is not S.NONCONFORMING:
                return super().decide(now, request)
            self.asked.append((now, request, None))
            return ApprovalDecision(False, "DSS: status 503")

    approver = Refuses()
    run = loop(approver, 8.0, plan=square(side_m=100.0)).run(20)
    drifted(run, 40.0, 40.0)
    assert approver.states("op0/a")[2:] == [S.NONCONFORMING, S.CONTINGENT]
    (gave_up,) = (note for _, _, note in run.notes if note.kind == "decision.gave_up")
    assert gave_up.data["reason"] == "outside its volumes, and approval rejected: DSS: status 503"


def test_a_state_that_the_approval_refuses_is_reported_again_after_a_pause() -> None:
    class Refuses(Watched):
        def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
            if request.state is not S.CONTINGENT:
                return super().decide(now, request)
            self.asked.append((now, request, None))
            return ApprovalDecision(False, "DSS: status 503")

    approver = Refuses()
    run = loop(approver, 8.0, plan=square(side_m=100.0)).run(20)
    drifted(run, 40.0, 20.0 + (EXCURSION_NS + RECOVERY_NS + 4 * REPORT_PAUSE_NS) / NS_PER_S)
    times = [now for now, request, _ in approver.asked if request.state is S.CONTINGENT]
    assert len(times) >= 3
    assert min(after - before for before, after in pairwise(times)) >= REPORT_PAUSE_NS


def test_a_flight_that_is_given_up_in_the_air_claims_its_way_home() -> None:
    class Withdraws(Watched):
        def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
            decision = super().decide(now, request)
            if request.vehicle == "op1/a":
                return ApprovalDecision(
                    True, ovn="x", overruled=(Overruled(intent_id("op0/a"), "op0", "op0/a", "rescue"),)
                )
            return decision

    approver = Withdraws()
    run = loop(approver, 4.0, 30.0, plan=square(side_m=60.0))
    run.blocked.add("approval:op1")
    run.run(6)
    run.blocked.clear()
    run.run(300)
    assert outcome(run) == ("failed", "approval withdrawn: rescue")
    assert S.CONTINGENT in approver.states("op0/a")


def test_an_approval_that_is_taken_back_on_the_ground_is_asked_for_again() -> None:
    class Withdraws(Watched):
        def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
            if request.vehicle == "op1/a":
                self.end(now, intent_id("op0/a"))
                return ApprovalDecision(
                    True, ovn="x", overruled=(Overruled(intent_id("op0/a"), "op0", "op0/a", "rescue"),)
                )
            return super().decide(now, request)

    approver = Withdraws()
    run = loop(approver, 20.0, 30.0)
    run.blocked.add("approval:op1")
    run.run(6)
    run.blocked.clear()
    run.run(200)
    assert outcome(run) == ("complete", "")
    assert approver.states("op0/a") == [S.ACCEPTED, S.ENDED, S.ACCEPTED, S.ACTIVATED, S.ENDED]


@pytest.mark.parametrize("kind", ["auto", "guided"])
def test_an_altered_plan_is_higher_and_beside_and_starts_and_lands_where_it_did(kind: plans.Kind) -> None:
    plan = square(kind, side_m=50.0)
    before, after = enu_points(plan), enu_points(altered(plan, 15.0, 20.0, -10.0))
    assert after[0] == before[0]
    assert after[-1] == pytest.approx(before[-1], abs=0.05)
    assert max(point.up_m for point in after) == pytest.approx(max(point.up_m for point in before) + 15.0)
    for east_m, north_m in ((0.0, 50.0), (50.0, 50.0)):
        moved = (HOME[0] + east_m + 20.0, HOME[1] + north_m - 10.0, 20.0)
        assert any(point == pytest.approx(moved, abs=0.05) for point in after)


def test_a_volume_contains_what_lies_within_its_outline_heights_and_times() -> None:
    claim = volumes(square(side_m=100.0), 10 * NS_PER_S)
    lat, lon = ORIGIN.geodetic_of(HOME[0], HOME[1] + 50.0)
    up_m = ORIGIN.ellipsoid_of(ORIGIN.alt_msl_m) + 5.0
    assert contains(claim, 20 * NS_PER_S, lat, lon, up_m)
    assert not contains(claim, 0, lat, lon, up_m)
    assert not contains(claim, 20 * NS_PER_S, lat, lon, up_m + 10.0)
    assert not contains(claim, 20 * NS_PER_S, *ORIGIN.geodetic_of(HOME[0] + 20.0, HOME[1] + 50.0), up_m)
