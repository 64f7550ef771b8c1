"""Conformance check of what decides on flight plans (`skyrange.utm.contract.ApprovalPolicy`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from skyrange.core.errors import DecodeError
from skyrange.core.time import NS_PER_S, Epoch, Time
from skyrange.core.volumes import Volume4D
from skyrange.testing.drivers.agent_driver import copied
from skyrange.testing.drivers.purity import Call, plainly, watched
from skyrange.testing.rules import Broken, RuleBook, need, same, short
from skyrange.utm.contract import Alternative, ApprovalDecision, ApprovalPolicy, OperationalIntent, intent_id
from skyrange.utm.messages import MAX_VERTICES, MAX_VOLUMES, DecisionBody, Response, decode_response, encode

EPOCH = Epoch(1_767_268_800 * NS_PER_S)
"""2026-01-01T12:00:00Z, where the check's requests lie in UTC."""
DAY_S = 86_400

APPROVAL: RuleBook[ApprovalCase] = RuleBook("approval")

TimedIntent = tuple[Time, OperationalIntent]


@dataclass
class ApprovalCase:
    """A policy to be checked: how a fresh one is made, and what it is asked."""

    make: Callable[[], ApprovalPolicy]
    requests: Sequence[TimedIntent]


def check_policy(make: Callable[[], ApprovalPolicy], requests: Sequence[TimedIntent], name: str | None = None) -> None:
    """Check that the policies which `make` returns keep every rule of `APPROVAL`; each call returns a fresh one."""
    APPROVAL.check(f"approval {name or type(make()).__name__}", ApprovalCase(make, requests))


def box(
    north_deg: float, east_deg: float, *, size_deg: float = 0.001, lower_m: float = 20.0, start_s: float = 60.0
) -> Volume4D:
    """A square prism 40 m high that is claimed for two minutes."""
    ring = (
        (north_deg, east_deg),
        (north_deg, east_deg + size_deg),
        (north_deg + size_deg, east_deg + size_deg),
        (north_deg + size_deg, east_deg),
    )
    start = round(start_s * NS_PER_S)
    return Volume4D(ring, lower_m, lower_m + 40.0, start, start + 120 * NS_PER_S)


def ordinary() -> list[TimedIntent]:
    """Requests of two operators over one city: apart, overlapping in space, in time, in both; a second version."""
    lat, lon = 40.778, -73.955
    plans = [
        ("blue/b1", (box(lat, lon), box(lat + 0.001, lon))),
        ("green/g1", (box(lat + 0.01, lon + 0.01),)),
        ("green/g2", (box(lat + 0.0005, lon + 0.0005),)),
        ("green/g3", (box(lat, lon, start_s=600.0),)),
        ("blue/b2", (box(lat, lon, lower_m=100.0),)),
        ("blue/b3", (box(lat, lon), box(lat, lon))),
    ]
    requests = [
        (number * NS_PER_S, OperationalIntent(intent_id(vehicle), vehicle.split("/")[0], vehicle, volumes))
        for number, (vehicle, volumes) in enumerate(plans)
    ]
    requests.append(
        (20 * NS_PER_S, OperationalIntent(intent_id("blue/b1", 1), "blue", "blue/b1", (box(lat, lon),), 100))
    )
    return requests


def extreme() -> list[TimedIntent]:
    """Requests that are valid and unlikely: poles, antimeridian, slivers, knots, giants, long ago, far ahead, many."""
    rim = tuple(
        (40.0 + math.sin(2 * math.pi * k / MAX_VERTICES), -74.0 + math.cos(2 * math.pi * k / MAX_VERTICES))
        for k in range(MAX_VERTICES)
    )
    soon, later = 60 * NS_PER_S, 120 * NS_PER_S
    volumes: list[tuple[Volume4D, ...]] = [
        (Volume4D(((90.0, -180.0), (90.0, 0.0), (90.0, 180.0)), 0.0, 1.0, soon, later),),
        (Volume4D(((10.0, 179.999), (10.0, -179.999), (10.001, -179.999), (10.001, 179.999)), 0.0, 1.0, soon, later),),
        (Volume4D(((-90.0, -180.0), (-90.0, 180.0), (90.0, 180.0), (90.0, -180.0)), -8e3, 1e5, soon, later),),
        (Volume4D(((1.0, 1.0), (1.0, 1.0), (1.0, 1.0)), 0.0, 1e-9, soon, soon + 1_000),),
        (Volume4D(((0.0, 0.0), (0.0, 1.0), (0.0, 2.0)), 0.0, 1.0, soon, later),),
        (Volume4D(((0.0, 0.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0)), 0.0, 1.0, soon, later),),
        (Volume4D(rim, 0.0, 100.0, soon, later),),
        (box(40.0, -74.0, start_s=-365.0 * DAY_S),),
        (box(40.0, -74.0, start_s=100 * 365.0 * DAY_S),),
        tuple(box(40.0 + 1e-4 * k, -74.0, start_s=60.0 + k) for k in range(MAX_VOLUMES)),
    ]
    return [
        (
            number,
            OperationalIntent(intent_id(f"blue/x{number}"), "blue", f"blue/x{number}", claim, 1_000 * (number % 2)),
        )
        for number, claim in enumerate(volumes)
    ]


@APPROVAL.rule("decides", "Answers every valid request with a Decision.")
def _decides(case: ApprovalCase) -> None:
    _ask(case.make(), case.requests)


@APPROVAL.rule("says-why", "Accepts with an OVN and no alternatives, or rejects with a reason.")
def _says_why(case: ApprovalCase) -> None:
    for decision in _ask(case.make(), case.requests):
        if decision.accepted:
            need(bool(decision.ovn), f"accepted with {short(decision)}", "an OVN that names the accepted version")
            need(not decision.alternatives, f"accepted with {short(decision)}", "no alternatives to what is accepted")
        else:
            need(bool(decision.reason), f"rejected with {short(decision)}", "a reason")


@APPROVAL.rule("alternatives", "Offers only alternatives that can be requested: on the globe, and ending after now.")
def _alternatives(case: ApprovalCase) -> None:
    for (now, _), decision in zip(case.requests, _ask(case.make(), case.requests), strict=True):
        for alternative in decision.alternatives:
            need(isinstance(alternative, Alternative), f"offered {short(alternative)}", "an Alternative")
        for volume in [volume for alternative in decision.alternatives for volume in alternative.volumes]:
            need(isinstance(volume, Volume4D), f"offered {short(volume)}", "a Volume4D")
            corners = all(abs(lat) <= 90.0 and abs(lon) <= 180.0 for lat, lon in volume.outline)  # not NaN either
            need(corners, f"offered the outline {short(volume.outline)}", "degrees within ±90 and ±180")
            need(volume.end_ns > now, f"offered {volume.end_ns} ns as an end, at {now}", "a volume that is not over")


@APPROVAL.rule("sendable", "Makes decisions that the approval link carries unchanged.")
def _sendable(case: ApprovalCase) -> None:
    for (_, intent), decision in zip(case.requests, _ask(case.make(), case.requests), strict=True):
        try:
            response = Response.of(intent.id, decision, EPOCH)
            back = decode_response(encode(response)).body
        except (ValueError, TypeError, DecodeError, OverflowError) as error:
            raise Broken(f"{short(decision)} cannot be sent: {error}", "a decision that the message holds") from error
        assert isinstance(back, DecisionBody)
        same(decision.reason, back.reason, "the reason, said and sent, differs", "at most 256 characters")


@APPROVAL.rule("repeatable", "Two new instances with the same requests in the same order give the same answers.")
def _repeatable(case: ApprovalCase) -> None:
    first, second = (_ask(case.make(), case.requests) for _ in range(2))
    same(first, second, "two instances differ", "the same from the same inputs")


@APPROVAL.rule("idempotent", "Answers a repeated request as before: an intent does not conflict with itself.")
def _idempotent(case: ApprovalCase) -> None:
    approval = case.make()
    for now, intent in case.requests:
        answers = _ask(approval, [(now, intent), (now, intent)])
        first, again = (replace(answer, overruled=()) for answer in answers)  # what it overrules, it overrules once
        same(first, again, f"{intent.vehicle} asks twice and gets two answers", "the same answer")


@APPROVAL.rule(
    "pure", "Reads no clock, draws no random numbers of its own, never sleeps, and opens no file, socket or thread."
)
def _pure(case: ApprovalCase) -> None:
    _ask(case.make(), case.requests)
    _ask(case.make(), case.requests, watched)


@APPROVAL.rule("copies", "A copy or fork made midway continues like the original, and shares no state with it.")
def _copies(case: ApprovalCase) -> None:
    straight = _ask(case.make(), case.requests)
    for middle in range(len(case.requests)):
        trunk = case.make()
        _ask(trunk, case.requests[:middle])
        branch = copied(trunk)
        rest, expected = straight[middle:], "a copy that goes on alike, and an original that does not notice"
        same(rest, _ask(branch, case.requests[middle:]), "the straight run and the copy differ", expected)
        same(rest, _ask(trunk, case.requests[middle:]), "the copy's life shows in the original", expected)


@APPROVAL.rule("extreme", "Decides on every valid volume, however unlikely, and on later requests.")
def _extreme(case: ApprovalCase) -> None:
    _ask(case.make(), [*extreme(), *case.requests])


@APPROVAL.rule("ends", "Ends any intent, known or not, and then decides as if it had never existed.")
def _ends(case: ApprovalCase) -> None:
    fresh, used = case.make(), case.make()
    for now, intent in case.requests:
        _ask(used, [(now, intent)])
        for ended_id in (intent.id, intent_id("nobody/n1")):
            try:
                used.end(now, ended_id)
            except Exception as error:
                raise Broken(
                    f"end({now}, {ended_id!r}) raised {error!r}", "the end of an intent, known or not"
                ) from error
    again = [(case.requests[-1][0], case.requests[0][1])]
    same(
        _ask(fresh, again),
        _ask(used, again),
        "what was ended shows in later decisions",
        "the airspace of an ended intent released",
    )


def _ask(approval: ApprovalPolicy, requests: Sequence[TimedIntent], call: Call = plainly) -> list[ApprovalDecision]:
    decisions = []
    for now, intent in requests:
        try:
            decision = call(approval.decide, now, intent)
        except Broken:
            raise
        except Exception as error:
            raise Broken(f"decide({now}, {short(intent)}) raised {error!r}", "a Decision") from error
        need(isinstance(decision, ApprovalDecision), f"answered {short(intent)} with {short(decision)}", "a Decision")
        decisions.append(decision)
    return decisions
