"""The flight approval agent: answers, repeats, refuses, survives."""

from __future__ import annotations

import copy

from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_S, Epoch, Time
from skyrange.core.volumes import Volume4D
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.approve_all import ApproveAll
from skyrange.utm.contract import Alternative, ApprovalDecision, OperationalIntent, intent_id
from skyrange.utm.messages import DecisionBody, ErrorBody, Request, decode_response, encode
from skyrange.utm.request_book import REMEMBERED

EPOCH = Epoch(1_767_268_800 * NS_PER_S)
VOLUME = Volume4D(((0.0, 0.0), (0.0, 0.1), (0.1, 0.1)), 0.0, 40.0, 0, NS_PER_S)


class FirstComes:
    """Accepts one intent per outline; counts what it is asked."""

    def __init__(self) -> None:
        self.asked: list[OperationalIntent] = []

    def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        self.asked.append(request)
        if len(self.asked) > 1:
            return ApprovalDecision(accepted=False, reason="conflict", alternatives=(Alternative((VOLUME,)),))
        return ApprovalDecision(accepted=True, ovn="first")

    def end(self, now: Time, intent: str) -> None:
        self.asked = [one for one in self.asked if one.id != intent]


def request(vehicle: str, operator: str = "", version: int = 0, priority: int = 0) -> bytes:
    operator = operator or vehicle.split("/", maxsplit=1)[0]
    return encode(
        Request.of(OperationalIntent(intent_id(vehicle, version), operator, vehicle, (VOLUME,), priority), EPOCH)
    )


def send(service: FlightApproval, operator: str, *payloads: bytes) -> Outbox:
    port = Port("approval", f"approval:{operator}")
    mail = [Arrival(port, 0, p, "", FrameId(port.link, "fwd", "x", n)) for n, p in enumerate(payloads)]
    return service.step(0, Inbox(mail))


def body(out: Outbox, number: int = 0) -> DecisionBody | ErrorBody:
    return decode_response(out.departures[number].payload).body


def test_a_request_is_answered_on_its_own_link_with_its_cause() -> None:
    service = FlightApproval(["blue", "green"], EPOCH, ApproveAll())
    out = send(service, "green", request("green/g1"))
    (departure,) = out.departures
    assert departure.port == Port("approval", "approval:green")
    assert departure.causes == (FrameId("approval:green", "fwd", "x", 0),)
    answer = body(out)
    assert isinstance(answer, DecisionBody)
    assert answer.decision == "Accepted"
    assert 16 <= len(answer.ovn) <= 128  # F3548-21 EntityOVN
    (note,) = out.notes
    assert (note.kind, note.about, note.causes) == ("decision.approval_accepted", "green/g1", departure.causes)
    assert service.next_wakeup() is None


def test_a_repeated_request_is_decided_once_and_answered_alike() -> None:
    approval = FirstComes()
    service = FlightApproval(["blue"], EPOCH, approval)
    first = send(service, "blue", request("blue/b1"))
    again = send(service, "blue", request("blue/b1"), request("blue/b1"))
    assert len(approval.asked) == 1
    assert [d.payload for d in again.departures] == [first.departures[0].payload] * 2
    assert again.notes == []
    changed = send(service, "blue", request("blue/b1", priority=2))
    assert len(approval.asked) == 2
    answer = body(changed)
    assert isinstance(answer, DecisionBody)
    assert (answer.decision, answer.reason) == ("Rejected", "conflict")
    assert answer.alternatives[0].volumes[0].volume4d(EPOCH) == VOLUME
    assert changed.notes[0].kind == "decision.approval_rejected"


def test_an_operator_cannot_ask_for_another() -> None:
    approval = FirstComes()
    service = FlightApproval(["blue", "green"], EPOCH, approval)
    out = send(service, "blue", request("green/g1"), request("green/g1", operator="blue"))
    assert approval.asked == []
    for number in range(2):
        assert decode_response(out.departures[number].payload).status == 403
    assert service.bad_frames == {"blue": 2, "green": 0}


def test_bad_bytes_are_counted_answered_and_noted_at_powers_of_two() -> None:
    service = FlightApproval(["blue"], EPOCH, ApproveAll())
    out = send(service, "blue", *([b"\xff{"] * 100))
    assert service.bad_frames["blue"] == 100
    assert [note.data["count"] for note in out.notes] == [1, 2, 4, 8, 16, 32, 64]
    assert {decode_response(d.payload).status for d in out.departures} == {400}
    assert isinstance(body(send(service, "blue", request("blue/b1"))), DecisionBody)


def test_what_it_remembers_is_bounded() -> None:
    approval = FirstComes()
    service = FlightApproval(["blue"], EPOCH, approval)
    for version in range(REMEMBERED + 1):
        send(service, "blue", request("blue/b1", version=version))
    send(service, "blue", request("blue/b1", version=REMEMBERED))
    assert len(approval.asked) == REMEMBERED + 1
    send(service, "blue", request("blue/b1", version=0))
    assert len(approval.asked) == REMEMBERED + 2


def test_a_copy_goes_on_alike() -> None:
    service = FlightApproval(["blue"], EPOCH, ApproveAll())
    send(service, "blue", request("blue/b1"))
    twin = copy.deepcopy(service)
    a = send(service, "blue", request("blue/b1"), request("blue/b2"))
    b = send(twin, "blue", request("blue/b1"), request("blue/b2"))
    assert (a.departures, a.notes) == (b.departures, b.notes)
