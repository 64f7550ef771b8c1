"""The approval authority: first come first served, alternatives, priorities, states, and what is wrong with a
request."""

from __future__ import annotations

from dataclasses import replace

import pytest

from skyrange.core.time import NS_PER_S
from skyrange.core.volumes import Volume4D
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.authority import Authority, AuthorityParams
from skyrange.utm.contract import ApprovalDecision, OperationalIntent, intent_id
from skyrange.utm.intent_register import KEPT_NS
from skyrange.utm.intent_states import MAX_HORIZON_NS, OFF_NOMINAL, TRANSITIONS, IntentState, may_follow
from tests.unit.test_utm_service import EPOCH, body, request, send

LAT, LNG = 40.778, -73.955


def prism(north: float = 0.0, *, lower_m: float = 0.0, start_s: float = 60.0, size: float = 0.001) -> Volume4D:
    south = LAT + north
    ring = ((south, LNG), (south, LNG + size), (south + size, LNG + size), (south + size, LNG))
    return Volume4D(ring, lower_m, lower_m + 40.0, round(start_s * NS_PER_S), round((start_s + 120.0) * NS_PER_S))


def intent(
    vehicle: str, *volumes: Volume4D, priority: int = 0, state: IntentState = IntentState.ACCEPTED
) -> OperationalIntent:
    return OperationalIntent(
        intent_id(vehicle), vehicle.split("/", maxsplit=1)[0], vehicle, volumes or (prism(),), priority, state
    )


def authority(**params: object) -> Authority:
    return Authority(AuthorityParams.model_validate(params))


def test_who_comes_first_is_accepted_and_the_other_is_told_who_is_in_the_way_and_what_is_free() -> None:
    approver = authority()
    assert approver.decide(0, intent("blue/b1")).accepted
    decision = approver.decide(0, intent("green/g1", prism(0.0005), prism(0.01)))
    assert not decision.accepted
    assert decision.reason == "volume 1 overlaps a volume of blue/b1"
    for number, alternative in enumerate(decision.alternatives):
        vehicle = f"green/g{number + 2}"
        assert authority_with_b1().decide(0, intent(vehicle, *alternative.volumes)).accepted
    assert {(one.climb_m > 0, one.delay_ns > 0) for one in decision.alternatives} >= {(False, True)}


def authority_with_b1() -> Authority:
    approver = authority()
    approver.decide(0, intent("blue/b1"))
    return approver


def test_an_alternative_stays_below_the_ceiling_and_within_the_longest_delay() -> None:
    approver = authority(max_delay_s=60, ceiling_m=50)
    approver.decide(0, intent("blue/b1"))
    assert approver.decide(0, intent("green/g1")).alternatives == ()
    with_delay = authority(max_delay_s=121, ceiling_m=50, aside_m=[])
    with_delay.decide(0, intent("blue/b1"))
    (only,) = with_delay.decide(0, intent("green/g1")).alternatives
    assert only.delay_ns == 120 * NS_PER_S


def test_what_has_ended_is_in_nobodys_way() -> None:
    approver = authority_with_b1()
    approver.end(0, intent_id("blue/b1"))
    assert approver.decide(0, intent("green/g1")).accepted


def test_an_intent_is_not_in_its_own_way_and_keeps_its_claim_while_a_new_version_is_refused() -> None:
    approver = authority_with_b1()
    assert approver.decide(1, intent("blue/b1", prism(0.0002))).accepted
    approver.decide(1, intent("green/g1", prism(0.01)))
    assert not approver.decide(2, intent("blue/b1", prism(0.0102))).accepted
    assert not approver.decide(3, intent("green/g2")).accepted


def test_a_higher_priority_overrules_and_an_equal_one_does_not() -> None:
    approver = authority_with_b1()
    assert not approver.decide(0, intent("green/g1", priority=0)).accepted
    decision = approver.decide(0, intent("red/r1", priority=5))
    assert decision.accepted
    (overruled,) = decision.overruled
    assert (overruled.id, overruled.operator, overruled.vehicle) == (intent_id("blue/b1"), "blue", "blue/b1")
    assert not approver.decide(0, intent("blue/b1")).accepted


def test_the_operator_of_an_overruled_intent_is_told() -> None:
    class Overrules(Authority):
        def decide(self, now: int, request: OperationalIntent) -> ApprovalDecision:
            return super().decide(now, replace(request, priority=5 if request.vehicle == "red/r1" else 0))

    service = FlightApproval(["blue", "red"], EPOCH, Overrules(AuthorityParams()))
    send(service, "blue", request("blue/b1"))
    out = send(service, "red", request("red/r1"))
    told = body(out, 0)
    assert out.departures[0].port.link == "approval:blue"
    assert (told.id, told.decision, told.overruled) == (intent_id("blue/b1"), "Rejected", True)  # type: ignore[union-attr]
    assert body(out, 1).decision == "Accepted"  # type: ignore[union-attr]
    assert [note.kind for note in out.notes] == ["decision.approval_accepted", "decision.approval_overruled"]


def test_an_activated_intent_that_is_outranked_keeps_its_claim_and_may_be_changed_within_the_conflict() -> None:
    approver = authority_with_b1()
    assert approver.decide(1, intent("blue/b1", state=IntentState.ACTIVATED)).accepted
    (told,) = approver.decide(2, intent("red/r1", priority=5)).overruled
    assert (told.vehicle, told.in_flight) == ("blue/b1", True)
    assert not approver.decide(3, intent("green/g1")).accepted, "it is still there"
    wider = intent("blue/b1", prism(0.0005), state=IntentState.ACTIVATED)
    assert approver.decide(4, wider).accepted, "the conflict with red/r1 was there before"
    approver.decide(5, intent("green/g2", prism(0.01)))
    both = OperationalIntent(
        intent_id("blue/b1"), "blue", "blue/b1", (*wider.volumes, prism(0.01)), state=IntentState.ACTIVATED
    )
    assert not approver.decide(6, both).accepted, "a new conflict is none that was there before"


@pytest.mark.parametrize("state", sorted(OFF_NOMINAL))
def test_an_aircraft_outside_its_volumes_is_never_refused_and_blocks_whoever_comes(state: IntentState) -> None:
    approver = authority_with_b1()
    approver.decide(0, intent("green/g1", prism(0.01)))
    assert approver.decide(1, intent("green/g1", prism(0.0), state=state)).accepted
    assert not approver.decide(2, intent("red/r1", prism(0.0005), priority=9)).accepted


def test_states_follow_each_other_as_the_standard_has_it() -> None:
    for before, row in TRANSITIONS.items():
        for after in IntentState:
            approver = authority()
            path = {
                None: [],
                IntentState.ACCEPTED: [IntentState.ACCEPTED],
                IntentState.ACTIVATED: [IntentState.ACTIVATED],
                IntentState.NONCONFORMING: [IntentState.ACTIVATED, IntentState.NONCONFORMING],
                IntentState.CONTINGENT: [IntentState.ACTIVATED, IntentState.CONTINGENT],
            }.get(before)
            if path is None or after is IntentState.ENDED:
                continue
            for state in path:
                assert approver.decide(0, intent("blue/b1", state=state)).accepted
            decision = approver.decide(1, intent("blue/b1", prism(0.1), state=after))
            assert decision.accepted == (after in row) == may_follow(before, after)
            if not decision.accepted:
                name = before.value if before else "unknown"
                assert decision.reason == f"an intent that is {name} cannot become {after.value}"


@pytest.mark.parametrize(
    ("volume", "reason"),
    [
        (prism(start_s=-600.0), "all its volumes are over"),
        (prism(start_s=MAX_HORIZON_NS / NS_PER_S), "it ends more than 30 days ahead"),
        (
            Volume4D(((0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0)), 0.0, 1.0, 0, NS_PER_S),
            "the outline of volume 1 crosses itself, or has no area",
        ),
        (
            Volume4D(((0.0, 0.0), (0.0, 1.0), (0.0, 2.0)), 0.0, 1.0, 0, NS_PER_S),
            "the outline of volume 1 crosses itself, or has no area",
        ),
    ],
)
def test_what_is_wrong_with_a_request_by_itself_is_said(volume: Volume4D, reason: str) -> None:
    decision = authority().decide(0, intent("blue/b1", volume))
    assert (decision.accepted, decision.reason, decision.alternatives) == (False, reason, ())


def test_what_nobody_ends_is_forgotten_in_time() -> None:
    approver = authority_with_b1()
    later = prism().end_ns + KEPT_NS
    assert approver.owner_of(intent_id("blue/b1")) == "blue"
    approver.decide(later + 1, intent("green/g1", prism(start_s=9e3)))
    assert approver.owner_of(intent_id("blue/b1")) is None
    assert approver.owner_of(intent_id("green/g1")) == "green"


def test_an_intent_of_another_operator_cannot_be_changed() -> None:
    approver = authority_with_b1()
    stolen = replace(intent("red/r1", prism(0.1)), id=intent_id("blue/b1"))
    decision = approver.decide(1, stolen)
    assert (decision.accepted, decision.reason) == (False, "the intent belongs to another operator")
    assert not approver.decide(1, intent("green/g1")).accepted


def test_an_operator_cannot_end_what_belongs_to_another() -> None:
    service = FlightApproval(["blue", "red"], EPOCH, authority())
    send(service, "blue", request("blue/b1"))
    stolen = request("red/r1").replace(intent_id("red/r1").encode(), intent_id("blue/b1").encode())
    assert body(send(service, "red", stolen)).message.endswith("an intent of another operator")  # type: ignore[union-attr]
