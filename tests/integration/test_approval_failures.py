"""Does every failure of a DSS or of an approval service end in a clear outcome, after a bounded number of requests?"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import pytest

from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import APPROVAL, Port
from skyrange.core.time import NS_PER_S, Time
from skyrange.gcs.flight.airspace_claim import MAX_RETRIES
from skyrange.gcs.flight.lifecycle import Flight
from skyrange.gcs.plan import plans
from skyrange.gcs.station import GroundStation
from skyrange.record import MemoryObserver
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly
from skyrange.testing.checks.approval_policies import EPOCH, box
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.approve_all import ApproveAll
from skyrange.utm.contract import ApprovalContext, Constraint, intent_id
from skyrange.utm.federated.exchanges import MAX_TRIES
from skyrange.utm.federated.plugin import FEDERATED
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import PATH, Response, encode
from tests.approval_stations import LAT, LON, Station, ask, end, fly_requests
from tests.unit import fake_autopilot

Failure = Callable[[dict[str, Any]], bytes | None]
"""What a service sends instead of a response; `None` is nothing."""


def _status(status: int) -> Failure:
    def fail(response: dict[str, Any]) -> bytes:
        return json.dumps({**response, "status": status, "body": {"message": f"fails with {status}"}}).encode()

    return fail


def _alter(**changes: Any) -> Failure:
    """Successes whose references say something else."""

    def alter(value: Any) -> Any:
        if isinstance(value, dict):
            altered = {name: alter(one) for name, one in value.items()}
            return {**altered, **changes} if "ovn" in value else altered
        return [alter(one) for one in value] if isinstance(value, list) else value

    def fail(response: dict[str, Any]) -> bytes:
        return json.dumps(alter(response)).encode()

    return fail


FAILURES: Final[dict[str, Failure]] = {
    "silence": lambda response: None,
    **{f"status {status}": _status(status) for status in (301, 400, 401, 403, 404, 409, 413, 429, 500, 502, 503, 599)},
    "no JSON": lambda response: b"<html>",
    "another type": lambda response: json.dumps({**response, "body": []}).encode(),
    "empty body": lambda response: json.dumps({**response, "body": {}}).encode(),
    "no body": lambda response: json.dumps({**response, "body": None}).encode(),
    "another intent": _alter(id=intent_id("other")),
    "another manager": _alter(manager="other"),
    "another state": _alter(state="Contingent"),
    "the first state": _alter(state="Accepted"),
    "another version": _alter(version=-1),
    "no OVN": _alter(ovn=None),
    "empty OVN": _alter(ovn=""),
    "a time before 1970": _alter(time_start={"value": "0001-01-01T00:00:00Z", "format": "RFC3339"}),
}


def _break(agent: Any, failure: Failure, after: int) -> None:
    """Have all responses of an agent fail after the first ones."""
    step, count = agent.step, 0

    def broken(now: Time, inbox: Inbox) -> Outbox:
        nonlocal count
        out: Outbox = step(now, inbox)
        kept = []
        for departure in out.departures:
            count += 1
            payload = departure.payload if count <= after else failure(json.loads(departure.payload))
            if payload is not None:
                kept.append(departure._replace(payload=payload))
        out.departures[:] = kept
        return out

    agent.step = broken


def _fly_federation(
    failure: Failure, after: int, rows: Sequence[tuple[float, bytes]], until_s: float, **more: Any
) -> tuple[Station, MemoryObserver]:
    """A federation whose DSS fails after some responses, and an operator that asks it."""
    context = ApprovalContext(f"{APPROVAL}.federated", ["blue"], Origin(LAT, LON), EPOCH, Chance(1), **more)
    service = FEDERATED(FEDERATED.params(), context)
    _break(service.agents[0], failure, after)
    stations, seen = fly_requests({"blue": rows}, until_s, service.agents, service.links, 1)
    return stations["blue"], seen


@pytest.mark.parametrize("failure", FAILURES.values(), ids=FAILURES)
def test_every_failure_of_the_dss_is_a_final_answer_to_every_request(failure: Failure) -> None:
    """Whatever the DSS answers wrongly, from whichever response on: no request is open, or repeated, for ever."""
    volume = box(LAT, LON, start_s=5.0)
    states = [IntentState.ACCEPTED, IntentState.ACTIVATED, IntentState.NONCONFORMING]
    rows = [(0.1 + 15.0 * k, ask("blue/a", volume, state=state, version=k)) for k, state in enumerate(states)]
    for after in range(5):
        station, seen = _fly_federation(failure, after, [*rows, (50.0, end("blue/a"))], 145.0)
        answers = [body for _, body in station.answers]
        assert [body.decision for body in answers][-1] == "Ended", (after, answers)
        assert len(answers) == 4, (after, answers)
        for body in answers:
            assert body.decision != "Rejected" or (body.reason and not body.alternatives), (after, body)
        asked = [one.sent_ns for one in seen.frames if one.src == "approval.blue" and one.link.startswith("uss:")]
        assert sum(at < 45 * NS_PER_S for at in asked) <= 3 * 4 * MAX_TRIES, (after, len(asked))
        assert max(asked) < 137 * NS_PER_S, "an end is tried until the time of the intent is over"


@pytest.mark.parametrize("failure", FAILURES.values(), ids=FAILURES)
def test_a_constraint_that_the_dss_refuses_is_given_up_and_no_other_is_tried_after_its_end(failure: Failure) -> None:
    constraint = Constraint("fire", box(LAT, LON, start_s=5.0), 0)
    _, seen = _fly_federation(failure, 0, (), 200.0, constraints=[constraint])
    refused = b"fails with 4" in (failure({"status": 201}) or b"")
    sent = [one.sent_ns for one in seen.frames if b"/dss/v1/constraint_references/" in one.payload]
    assert sent
    assert max(sent) < (NS_PER_S if refused else 133 * NS_PER_S)


# ---------------------------------------------------------------- the approval itself


def _error(status: int) -> Callable[[bytes], bytes]:
    def fail(payload: bytes) -> bytes:
        return encode(Response.error(status, json.loads(payload)["path"], f"fails with {status}"))

    return fail


APPROVAL_FAILURES: Final[dict[str, tuple[Callable[[bytes], bytes | None], str]]] = {
    "silence": (lambda payload: None, "approval: no answer after 6 requests"),
    "nonsense": (lambda payload: b"\xff\x00{", "approval: no answer after 6 requests"),
    "an echo": (lambda payload: payload, "approval: no answer after 6 requests"),
    "an error without a path": (
        lambda payload: encode(Response.error(400, PATH, "what?")),
        "approval: no answer after 6 requests",
    ),
    **{
        f"status {status}": (
            _error(status),
            f"approval: no decision after 6 requests; it answers status {status}: fails with {status}",
        )
        for status in (400, 401, 403, 404, 413, 429, 500, 503, 504)
    },
}


class _FailingApproval(FlightApproval):
    """Answers each request by `fail`."""

    def __init__(self, fail: Callable[[bytes], bytes | None]) -> None:
        super().__init__(["blue"], EPOCH, ApproveAll())
        self.fail, self.asked = fail, 0

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        for arrival in inbox:
            self.asked += 1
            payload = self.fail(arrival.payload)
            if payload is not None:
                out.send(Port(APPROVAL, "approval:blue"), payload)
        return out


@pytest.mark.parametrize(("fail", "reason"), APPROVAL_FAILURES.values(), ids=APPROVAL_FAILURES)
def test_every_failure_of_the_approval_is_a_reason_why_the_flight_has_failed(
    fail: Callable[[bytes], bytes | None], reason: str
) -> None:
    home = (5.0, 5.0, 0.0)
    plan = plans.square(fake_autopilot.ORIGIN, home, side_m=5.0, alt_m=5)
    station = GroundStation("blue", [Flight("blue/a", 1, plan, 1.0)], EPOCH)
    approval = _FailingApproval(fail)
    aircraft = {"blue/a": fake_autopilot.FakeAutopilot(1, home)}
    fake_autopilot.Loop([station], aircraft, approval).run(20.0)
    found = station.outcomes["blue/a"]
    assert (found.state, found.reason) == ("failed", reason)
    assert approval.asked == MAX_RETRIES + 1


def test_a_flight_over_an_area_that_the_dss_does_not_search_fails_with_its_reason(tmp_path: Path) -> None:
    scenario = load_text(
        """
        name = "far"
        duration_s = 3
        origin = [47.4, 8.5]
        [[operators]]
        id = "blue"
        approval = "federated"
          [[operators.vehicles]]
          plan = { path = { points = [[0, 0], [55000, 55000]], alt_m = 60 }, end = "land", speed_mps = 15 }
        """
    )
    found = fly(scenario, tmp_path / "run", report=False).manifest["outcomes"]["blue/b1"]
    assert found["state"] == "failed"
    assert found["reason"].startswith("approval rejected: DSS: area too large: ")
