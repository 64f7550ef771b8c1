"""Approval authority: one approver that keeps the only database of intents, as in the published centralised design.

An intent is accepted if its volumes overlap no other intent's of the same or a higher priority, and none of an aircraft
that does not keep to its own. Requests are decided as they come, or in an order that is fair to the operators. A
rejection carries alternatives. What an aircraft that has left its volumes claims is never refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from skyrange.contracts.params import Number, Params
from skyrange.core.time import NS_PER_S, Time
from skyrange.utm.alternatives import Limits
from skyrange.utm.approval_service import policy_plugin
from skyrange.utm.contract import ApprovalDecision, OperationalIntent, is_constraint, overruled_by, version_number
from skyrange.utm.intent_register import IntentRegister, find_problem
from skyrange.utm.intent_states import OFF_NOMINAL
from skyrange.utm.journal import Journal, NoJournal
from skyrange.utm.request_book import RequestQueue, least_served


class AlternativeParams(Params):
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

    @property
    def limits(self) -> Limits:
        """The limits of alternatives."""
        return Limits(self.max_delay_s, self.climbs_m, self.aside_m, self.ceiling_m, self.alternatives)


class AuthorityParams(AlternativeParams):
    """Limits of the alternatives that are offered, and the order of decisions."""

    order: Literal["first_come", "least_served"] = Field(
        default="first_come",
        description="first_come: each request is decided when it arrives. least_served: requests for later flights "
        "wait for window_s; then that of the operator with the fewest accepted intents is decided first.",
    )
    window_s: Number = Field(
        default=1.0,
        gt=0,
        le=5,
        description="How long the first of the waiting requests waits, in seconds; ground stations give up after 9 s.",
    )

    def make_queue(self) -> RequestQueue | None:
        """The queue of the order; None if nothing waits."""
        return None if self.order == "first_come" else RequestQueue(least_served, round(self.window_s * NS_PER_S))


class Authority:
    """The approval authority (kind `authority`)."""

    def __init__(
        self,
        params: AlternativeParams,
        journal: Journal[OperationalIntent] | None = None,
        accepted: Iterable[OperationalIntent] = (),
    ) -> None:
        """`accepted` are the intents of before a restart."""
        self._register = IntentRegister(params.limits)
        self._decisions: dict[str, ApprovalDecision] = {}
        """Of the intents that are accepted."""
        self._journal: Journal[OperationalIntent] = NoJournal()
        for intent in accepted:
            self._put(intent)
        self._journal = journal or NoJournal()

    def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        """Accept `request`, or reject it with the reason, and with alternatives if others are in its way."""
        return self._decide(now, request, offers=True)

    def follow(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        """The same decision without alternatives, which take time, for one who only keeps up with what is decided."""
        return self._decide(now, request, offers=False)

    def _decide(self, now: Time, request: OperationalIntent, *, offers: bool) -> ApprovalDecision:
        for forgotten in self._register.forget(now):
            del self._decisions[forgotten]
            self._journal.delete(forgotten)
        known_intent = self._register.get(request.id)
        if known_intent == request:
            return self._decisions[request.id]
        if known_intent is not None and known_intent.operator != request.operator:
            return ApprovalDecision(accepted=False, reason="the intent belongs to another operator")
        problem = find_problem(now, request, known_intent.state if known_intent is not None else None)
        if problem:
            return ApprovalDecision(accepted=False, reason=problem)
        if request.state in OFF_NOMINAL:
            return self._accept(request, ())
        if is_constraint(request):
            return self._accept(request, self._register.find_lower(request))
        examination = self._register.examine(request, offers=offers)
        if examination.reason:
            return ApprovalDecision(accepted=False, reason=examination.reason, alternatives=examination.alternatives)
        return self._accept(request, examination.outranked)

    def owner_of(self, intent: str) -> str | None:
        """The operator of an intent that is known."""
        known_intent = self._register.get(intent)
        return None if known_intent is None else known_intent.operator

    def end(self, now: Time, intent: str) -> None:
        """Release the airspace of an intent."""
        self._remove(intent)

    def _remove(self, intent: str) -> None:
        self._register.remove(intent)
        if self._decisions.pop(intent, None) is not None:
            self._journal.delete(intent)

    def _put(self, intent: OperationalIntent, conflicts: int = 0) -> ApprovalDecision:
        decision = ApprovalDecision(accepted=True, ovn=version_number(intent), tracked=True, conflicts=conflicts)
        self._register.put(intent)
        self._decisions[intent.id] = decision
        self._journal.put(intent)
        return decision

    def _accept(self, request: OperationalIntent, outranked: Sequence[OperationalIntent]) -> ApprovalDecision:
        overruled = []
        for other in outranked:
            overruling = overruled_by(request, other)
            if not overruling.in_flight:
                self._remove(other.id)
            overruled.append(overruling)
        return replace(self._put(request, len(outranked)), overruled=tuple(overruled))


AUTHORITY = policy_plugin(
    AuthorityParams,
    Authority,
    "Accepts what overlaps no accepted intent, and offers alternatives: later, higher or beside.",
    AuthorityParams.make_queue,
)
