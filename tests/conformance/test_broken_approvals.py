"""Each rule for approvals is broken by an approval that breaks just that rule, and is found by its id."""

from __future__ import annotations

import itertools
import time
from dataclasses import replace
from typing import Any

import pytest

from skyrange.core.time import NS_PER_S, Time
from skyrange.core.volumes import Volume4D
from skyrange.testing import NonConformance, check_approval
from skyrange.testing.checks.approval_policies import APPROVAL, box
from skyrange.utm.contract import Alternative, ApprovalDecision, OperationalIntent


class FirstComes:
    """Accepts who overlaps nobody before (by bounding boxes), offers others ten minutes later: keeps every rule."""

    def __init__(self) -> None:
        self.granted: dict[str, tuple[Volume4D, ...]] = {}

    def decide(self, now: Time, request: OperationalIntent) -> Any:
        others = [v for of, volumes in self.granted.items() if of != request.id for v in volumes]
        taken = [other for mine in request.volumes for other in others if overlap(mine, other)]
        if not taken:
            self.granted[request.id] = request.volumes
            return self.grant(request)
        return self.refuse(now, request)

    def grant(self, request: OperationalIntent) -> ApprovalDecision:
        return ApprovalDecision(True, ovn=f"{request.id}-{len(request.volumes)}")

    def refuse(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        later = 600 * NS_PER_S
        moved = (replace(v, start_ns=v.start_ns + later, end_ns=v.end_ns + later) for v in request.volumes)
        return ApprovalDecision(False, "overlaps an accepted intent", (Alternative(tuple(moved), later),))

    def end(self, now: Time, intent: str) -> None:
        self.granted.pop(intent, None)


def overlap(a: Volume4D, b: Volume4D) -> bool:
    ranges = [(a.lower_m, a.upper_m, b.lower_m, b.upper_m), (a.start_ns, a.end_ns, b.start_ns, b.end_ns)]
    for axis in (0, 1):
        mine, other = [c[axis] for c in a.outline], [c[axis] for c in b.outline]
        ranges.append((min(mine), max(mine), min(other), max(other)))
    return all(low < other_high and other_low < high for low, high, other_low, other_high in ranges)


def test_the_unbroken_one_conforms_and_does_both() -> None:
    check_approval(FirstComes)
    from skyrange.testing.checks.approval_policies import ordinary

    clerk = FirstComes()
    assert {clerk.decide(now, intent).accepted for now, intent in ordinary()} == {True, False}


def refusing(decision: Any) -> type[FirstComes]:
    class Refuses(FirstComes):
        def refuse(self, now: Time, request: OperationalIntent) -> Any:
            return decision(now) if callable(decision) else decision

    return Refuses


def granting(decision: Any) -> type[FirstComes]:
    class Grants(FirstComes):
        def grant(self, request: OperationalIntent) -> Any:
            return decision

    return Grants


class Raises(FirstComes):
    def refuse(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        raise LookupError(request.vehicle)


TICKETS = itertools.count()


class Numbers(FirstComes):
    def grant(self, request: OperationalIntent) -> ApprovalDecision:
        return ApprovalDecision(True, ovn=f"{next(TICKETS)}")


class SelfBlocked(FirstComes):
    """Takes an intent for its own obstacle."""

    def decide(self, now: Time, request: OperationalIntent) -> Any:
        decision = super().decide(now, request)
        self.granted = {f"{key}+": volumes for key, volumes in self.granted.items()}
        return decision


class Clocked(FirstComes):
    def grant(self, request: OperationalIntent) -> ApprovalDecision:
        time.time_ns()
        return super().grant(request)


class Shares(FirstComes):
    def __deepcopy__(self, memo: object) -> Shares:
        twin = type(self)()
        twin.granted = self.granted
        return twin

    def grant(self, request: OperationalIntent) -> ApprovalDecision:
        return ApprovalDecision(True, ovn=f"{len(self.granted)}")


class Keeps(FirstComes):
    """Releases nothing."""

    def end(self, now: Time, intent: str) -> None:
        pass

    def grant(self, request: OperationalIntent) -> ApprovalDecision:
        return ApprovalDecision(True, ovn=f"{request.id}-{len(self.granted)}")


class Areas(FirstComes):
    def grant(self, request: OperationalIntent) -> ApprovalDecision:
        for volume in request.volumes:
            (south, west), (north, east) = volume.outline[0], volume.outline[2]
            assert south < north
            assert west < east
        return super().grant(request)


def nowhere(now: Time) -> ApprovalDecision:
    volume = box(40.0, -74.0, start_s=3_600.0)
    volume = replace(volume, outline=((91.0, 0.0), (91.0, 1.0), (92.0, 1.0)))
    return ApprovalDecision(False, "taken", (Alternative((volume,)),))


BREAKING: list[tuple[str, Any]] = [
    ("decides", Raises),
    ("decides", refusing(None)),
    ("ends", Keeps),
    ("decides", refusing(False)),
    ("says-why", refusing(ApprovalDecision(False))),
    ("says-why", granting(ApprovalDecision(True))),
    ("says-why", granting(ApprovalDecision(True, ovn="x", alternatives=(Alternative((box(0.0, 0.0, start_s=1e6),)),)))),
    ("alternatives", refusing(nowhere)),
    (
        "alternatives",
        refusing(lambda now: ApprovalDecision(False, "taken", (Alternative((box(0.0, 0.0, start_s=-600.0),)),))),
    ),
    ("alternatives", refusing(ApprovalDecision(False, "taken", ("later",)))),  # type: ignore[arg-type]
    ("sendable", refusing(ApprovalDecision(False, "too long " * 99))),
    ("sendable", granting(ApprovalDecision(True, ovn="x" * 129))),
    (
        "sendable",
        refusing(ApprovalDecision(False, "taken", (Alternative((box(0.0, 0.0, lower_m=2e5, start_s=600.0),)),))),
    ),
    ("repeatable", Numbers),
    ("idempotent", SelfBlocked),
    ("pure", Clocked),
    ("copies", Shares),
    ("extreme", Areas),
]


@pytest.mark.parametrize(("rule", "broken"), BREAKING, ids=[f"{rule}-{made.__name__}" for rule, made in BREAKING])
def test_a_broken_rule_is_found(rule: str, broken: Any) -> None:
    with pytest.raises(NonConformance) as found:
        check_approval(broken)
    assert found.value.rule == f"approval.{rule}", str(found.value)


def test_every_rule_is_shown_to_fail() -> None:
    assert {f"approval.{rule}" for rule, _ in BREAKING} == {rule.id for rule in APPROVAL.rules}
