"""Approval authority: one approver that keeps the only database of intents, as in the published centralised design.

An intent is accepted if its volumes overlap no other intent's of the same or a higher priority, and none of an aircraft
that does not keep to its own; first come, first served. A rejection carries alternatives. What an aircraft that has
left its volumes claims is never refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Annotated, Final

import shapely
from pydantic import Field

from skyrange.contracts.params import Number, Params
from skyrange.core.time import NS_PER_S, Time
from skyrange.core.volumes import Volume4D
from skyrange.utm.airspace import Airspace, Overlap, outlines_of
from skyrange.utm.alternatives import Limits, find_alternatives
from skyrange.utm.approval_service import policy_plugin
from skyrange.utm.contract import Alternative, ApprovalDecision, OperationalIntent, Overruled, version_number
from skyrange.utm.intent_states import MAX_HORIZON_NS, MAX_VERTICES, OFF_NOMINAL, IntentState, may_follow

KEPT_NS: Final = 3_600 * NS_PER_S
"""How long an intent that nobody has ended is known after its last volume."""


class AuthorityParams(Params):
    """Limits of the alternatives that are offered."""

    max_delay_s: Number = Field(
        default=3_600.0, ge=0, le=86_400, description="Longest delay of an alternative in seconds."
    )
    climbs_m: tuple[Annotated[float, Field(gt=0, le=1_000)], ...] = Field(
        default=(15.0, 30.0, 45.0),
        max_length=16,
        description="By how much higher an alternative may fly, in metres, the least first.",
    )
    aside_m: tuple[Annotated[float, Field(ge=-10_000, le=10_000)], ...] = Field(
        default=(25.0, -25.0, 50.0, -50.0),
        max_length=16,
        description="How far to the right of its way an alternative may fly, in metres, the nearest first; negative is "
        "to the left.",
    )
    ceiling_m: Number = Field(
        default=120.0,
        gt=0,
        le=10_000,
        description="Greatest height of an alternative above its lowest volume, in metres; 120 m is the limit of 14 "
        "CFR 107.51 and of the open category in Europe.",
    )
    alternatives: int = Field(default=3, ge=0, le=16, description="Most alternatives that a rejection carries.")


@dataclass(slots=True)
class Held:
    """An intent that the authority has accepted."""

    intent: OperationalIntent
    decision: ApprovalDecision


class Authority:
    """The approval authority (kind `authority`)."""

    def __init__(self, params: AuthorityParams) -> None:
        self._limits = Limits(
            params.max_delay_s, params.climbs_m, params.aside_m, params.ceiling_m, params.alternatives
        )
        self._airspace = Airspace()
        self._held: dict[str, Held] = {}
        self._ends: list[tuple[Time, str]] = []

    def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        """Accept `request`, or reject it with the reason, and with alternatives if others are in its way."""
        return self._decide(now, request, offers=True)

    def follow(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        """The same decision without alternatives, which take time, for one who only keeps up with what is decided."""
        return self._decide(now, request, offers=False)

    def _decide(self, now: Time, request: OperationalIntent, offers: bool) -> ApprovalDecision:
        self._forget(now)
        held = self._held.get(request.id)
        if held is not None and held.intent == request:
            return held.decision
        if held is not None and held.intent.operator != request.operator:
            return ApprovalDecision(accepted=False, reason="the intent belongs to another operator")
        problem = find_problem(now, request, held.intent.state if held is not None else None)
        if problem:
            return ApprovalDecision(accepted=False, reason=problem)
        if request.state in OFF_NOMINAL:
            return self._accept(request, ())
        overlaps = self._airspace.find_overlaps(request.volumes, ignored=request.id)
        blocking = [one for one in overlaps if self._blocks(one, request)]
        if blocking:
            alternatives = tuple(self._offer(request)) if offers else ()
            return ApprovalDecision(accepted=False, reason=self._describe(blocking), alternatives=alternatives)
        return self._accept(request, tuple(sorted({one.intent for one in overlaps})))

    def owner_of(self, intent: str) -> str | None:
        """The operator of an intent that is known."""
        held = self._held.get(intent)
        return None if held is None else held.intent.operator

    def end(self, now: Time, intent: str) -> None:
        """Release the airspace of an intent."""
        self._airspace.remove(intent)
        self._held.pop(intent, None)

    def _accept(self, request: OperationalIntent, outranked: Sequence[str]) -> ApprovalDecision:
        overruled = []
        for intent in outranked:
            other = self._held.pop(intent).intent
            self._airspace.remove(intent)
            reason = f"{request.vehicle}, of priority {request.priority}, has claimed a part of it"
            overruled.append(Overruled(intent, other.operator, other.vehicle, reason))
        self._airspace.put(request.id, request.volumes)
        heappush(self._ends, (max(one.end_ns for one in request.volumes) + KEPT_NS, request.id))
        ovn = version_number(request)
        self._held[request.id] = Held(request, ApprovalDecision(accepted=True, ovn=ovn, tracked=True))
        return ApprovalDecision(accepted=True, ovn=ovn, tracked=True, overruled=tuple(overruled))

    def _blocks(self, overlap: Overlap, request: OperationalIntent) -> bool:
        other = self._held[overlap.intent].intent
        return other.priority >= request.priority or other.state in OFF_NOMINAL

    def _offer(self, request: OperationalIntent) -> list[Alternative]:
        def search(volumes: Sequence[Volume4D], later_ns: Time) -> list[Overlap]:
            found = self._airspace.find_overlaps(volumes, later_ns, request.id)
            return [one for one in found if self._blocks(one, request)]

        return find_alternatives(request.volumes, search, self._limits)

    def _describe(self, blocking: Sequence[Overlap]) -> str:
        vehicles = list(dict.fromkeys(self._held[one.intent].intent.vehicle for one in blocking))
        others = f" and {len(vehicles) - 1} others" if len(vehicles) > 1 else ""
        return f"volume {blocking[0].place + 1} overlaps a volume of {vehicles[0]}{others}"

    def _forget(self, now: Time) -> None:
        """Forget intents that are long over."""
        while self._ends and self._ends[0][0] < now:
            _, intent = heappop(self._ends)
            held = self._held.get(intent)
            if held is not None and max(one.end_ns for one in held.intent.volumes) + KEPT_NS < now:
                self.end(now, intent)


def find_problem(now: Time, request: OperationalIntent, state: IntentState | None) -> str:
    """What is wrong with a request by itself, whatever others claim; `state` is that of the intent so far."""
    if not may_follow(state, request.state):
        return f"an intent that is {state.value if state else 'unknown'} cannot become {request.state.value}"
    if max(one.end_ns for one in request.volumes) <= now:
        return "all its volumes are over"
    if max(one.end_ns for one in request.volumes) > now + MAX_HORIZON_NS:
        return f"it ends more than {MAX_HORIZON_NS // (86_400 * NS_PER_S)} days ahead"
    vertices = sum(len(one.outline) for one in request.volumes)
    if vertices > MAX_VERTICES:
        return f"its outlines have {vertices} vertices, at most {MAX_VERTICES} are allowed"
    valid = shapely.is_valid(outlines_of(request.volumes))
    if not valid.all():
        return f"the outline of volume {int(valid.argmin()) + 1} crosses itself, or has no area"
    return ""


AUTHORITY = policy_plugin(
    AuthorityParams,
    Authority,
    "Accepts what overlaps no accepted intent, and offers alternatives: later, higher or beside.",
)
