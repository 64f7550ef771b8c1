"""Flight approval service: one agent at the endpoint `approval`, for all operators.

It reads requests, has its policy decide each distinct one once, at once or after others that wait, and answers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from skyrange.contracts.alerts import Scalar
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox, Turn
from skyrange.contracts.params import Params
from skyrange.core.ids import APPROVAL, Port, link_name
from skyrange.core.time import NEVER, NS_PER_MS, Epoch, Time
from skyrange.utm.contract import (
    ApprovalContext,
    ApprovalDecision,
    ApprovalPlugin,
    ApprovalPolicy,
    ApprovalService,
    Constraint,
    Publication,
    claim_of,
)
from skyrange.utm.messages import EndBody, Response, encode, encode_decision
from skyrange.utm.request_book import OpenRequest, RequestBook, RequestQueue

SERVICE_NS = 20 * NS_PER_MS
"""How often it looks at its mail, as the ground stations do."""


class FlightApproval:
    """The flight approval as an agent.

    Notes: `decision.approval_accepted`, `decision.approval_rejected`, `decision.approval_ended` and
    `decision.approval_overruled` about the vehicle, with the request as cause; `decision.approval_constraint` about
    itself, {constraint, overruled}; `decision.approval_bad_request` about
    the operator, at its 1st, 2nd, 4th, 8th …
    """

    def __init__(
        self,
        operators: Sequence[str],
        epoch: Epoch,
        policy: ApprovalPolicy,
        *,
        service_ns: Time = SERVICE_NS,
        name: str = APPROVAL,
        constraints: Sequence[Constraint] = (),
        queue: RequestQueue | None = None,
    ) -> None:
        """`policy` decides for all `operators`, each on its own link `approval:<operator>`, and on `constraints` when
        they are published. `queue` has requests wait for others; without one each is decided when it arrives.
        """
        self.name = name
        self.service_ns = service_ns
        self.ports: Sequence[Port] = tuple(Port(APPROVAL, link_name("approval", operator)) for operator in operators)
        self._book = RequestBook(list(zip(operators, self.ports, strict=True)))
        self._epoch = epoch
        self._policy = policy
        self._publication = Publication(constraints)
        self._queue = queue

    @property
    def bad_frames(self) -> dict[str, int]:
        """Requests per operator that were not understood."""
        return self._book.bad_frames

    def restore(self, operator: str, intent: str) -> None:
        """An intent is that of an operator, as was decided before a restart."""
        self._book.restore(operator, intent)

    def next_wakeup(self) -> Time | None:
        """When the next constraint is published, or the queue is due; otherwise it acts on mail."""
        if self._queue is None or self._queue.due is None:
            return self._publication.due
        return min(self._queue.due, NEVER if self._publication.due is None else self._publication.due)

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Take constraints into account that are published, and answer every request that arrived."""
        out = Outbox()
        turn = Turn(now, out)
        for constraint in self._publication.take(now):
            apply_constraint(turn, self.name, constraint, self._policy, self._book, self._epoch)
        for arrival in inbox:
            self._answer(turn.caused_by(arrival.ref), arrival)
        while self._queue is not None and (waiting := self._queue.take(now, self._book.accepted)) is not None:
            self._decide(turn, waiting)
        return out

    def _answer(self, turn: Turn, arrival: Arrival) -> None:
        open_request = self._book.read(arrival, turn.out)
        if open_request is None:
            return
        if self._queue is not None:
            earlier = self._queue.take_earlier(open_request.request.body.id)
            if earlier is not None:
                self._decide(turn, earlier)
            if self._queue.add(turn.now, open_request):
                return
        self._decide(turn, open_request)

    def _decide(self, turn: Turn, open_request: OpenRequest) -> None:
        decide_request(turn, open_request, self._policy, self._book, self._epoch)


def apply_constraint(
    turn: Turn, approval: str, constraint: Constraint, policy: ApprovalPolicy, book: RequestBook, epoch: Epoch
) -> None:
    """Have a policy take a constraint into account; tell those whose intents it closes."""
    decision = policy.decide(turn.now, claim_of(constraint.id, constraint.name, [constraint.volume]))
    data: dict[str, Scalar] = {"constraint": constraint.name, "overruled": len(decision.overruled)}
    turn = turn.caused_by()
    turn.note("decision.approval_constraint", approval, data)
    tell_overruled(turn, decision, book, epoch)


def decide_request(
    turn: Turn, open_request: OpenRequest, policy: ApprovalPolicy, book: RequestBook, epoch: Epoch
) -> None:
    """Have a policy decide a request, and answer it; tell those whose intents it overrules."""
    body = open_request.request.body
    if isinstance(body, EndBody):
        policy.end(turn.now, body.id)
        answer_end(turn, open_request, book)
    else:
        answer_intent(turn, open_request, policy.decide(turn.now, open_request.request.intent(epoch)), book, epoch)


def answer_end(turn: Turn, open_request: OpenRequest, book: RequestBook) -> None:
    """Answer a request that has ended an intent."""
    body = open_request.request.body
    turn.caused_by(open_request.cause).note("decision.approval_ended", body.vehicle, {"intent": body.id})
    book.answer(open_request, encode(Response.ended(body.id)), turn.out)


def answer_intent(
    turn: Turn, open_request: OpenRequest, decision: ApprovalDecision, book: RequestBook, epoch: Epoch
) -> None:
    """Answer a request for an intent, and tell those whose intents the decision overrules."""
    turn = turn.caused_by(open_request.cause)
    note_decision(turn, open_request, decision)
    tell_overruled(turn, decision, book, epoch)
    body = open_request.request.body
    version = None if isinstance(body, EndBody) else body.version
    book.answer(open_request, encode_decision(body.id, decision, epoch, version), turn.out, accepted=decision.accepted)


def tell_overruled(turn: Turn, overruling: ApprovalDecision, book: RequestBook, epoch: Epoch) -> None:
    """Tell the operators of `book` whose intents a decision has overruled."""
    for overruled in overruling.overruled:
        if overruled.operator in book.operators:
            decision = ApprovalDecision(
                accepted=overruled.in_flight, reason=overruled.reason, tracked=overruled.in_flight
            )
            turn.note(
                "decision.approval_overruled", overruled.vehicle, {"intent": overruled.id, "reason": overruled.reason}
            )
            book.retract(
                turn,
                overruled.operator,
                overruled.id,
                encode_decision(overruled.id, decision, epoch, overruled=overruled),
            )


def note_decision(turn: Turn, open_request: OpenRequest, decision: ApprovalDecision) -> None:
    """Record a decision on a request."""
    body = open_request.request.body
    data: dict[str, Scalar] = {"intent": body.id, "reason": decision.reason}
    if decision.tracked and not isinstance(body, EndBody):
        data["state"] = body.state.value
    if decision.alternatives:
        data["alternatives"] = len(decision.alternatives)
    kind = "decision.approval_accepted" if decision.accepted else "decision.approval_rejected"
    turn.note(kind, body.vehicle, data)


def policy_plugin(
    params: type[Params],
    make: Callable[[Any], ApprovalPolicy],
    about: str,
    make_queue: Callable[[Any], RequestQueue | None] | None = None,
) -> ApprovalPlugin:
    """An approval that is one service, of an object that decides: `make(params)` returns an `ApprovalPolicy`.

    `make_queue(params)` returns the queue in which requests wait, if they are to.
    """

    def serve(given: Params, context: ApprovalContext) -> ApprovalService:
        service = FlightApproval(
            context.operators,
            context.epoch,
            make(given),
            name=context.name,
            constraints=context.constraints,
            queue=make_queue(given) if make_queue is not None else None,
        )
        return ApprovalService([service])

    return ApprovalPlugin(params, serve, about, policy=make)
