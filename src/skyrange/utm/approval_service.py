"""Flight approval service: one agent at the endpoint `approval`, for all operators.

It reads requests, has its policy decide each distinct one once, and answers. A request that comes
again (its answer may have been lost) gets the same answer, without another decision. Nothing an
operator sends can stop it: bad bytes are counted, noted and answered with 400.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from hashlib import blake2b
from typing import Any

from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.contracts.params import Params
from skyrange.core.errors import DecodeError
from skyrange.core.ids import APPROVAL, Port, link_name, operator_of
from skyrange.core.time import NS_PER_MS, Epoch, Time
from skyrange.utm.contract import ApprovalContext, ApprovalPlugin, ApprovalPolicy, ApprovalService
from skyrange.utm.messages import PATH, ErrorBody, Response, decode_request, encode

SERVICE_NS = 20 * NS_PER_MS
"""How often it looks at its mail, as the ground stations do."""
REMEMBERED = 4_096
"""Answers kept per operator for requests that come again; older ones would be decided anew."""


class FlightApproval:
    """The flight approval as an agent.

    Notes: `decision.approval_accepted` and `decision.approval_rejected` about the vehicle, with the
    request as cause; `decision.approval_bad_request` about the operator, at its 1st, 2nd, 4th, 8th …
    """

    def __init__(
        self,
        operators: Sequence[str],
        epoch: Epoch,
        policy: ApprovalPolicy,
        *,
        service_ns: Time = SERVICE_NS,
        name: str = APPROVAL,
    ) -> None:
        """`policy` decides for all `operators`, each on its own link `approval:<operator>`."""
        self.name = name
        self.service_ns = service_ns
        self.ports: Sequence[Port] = tuple(Port(APPROVAL, link_name("approval", operator)) for operator in operators)
        self.bad_frames: dict[str, int] = dict.fromkeys(operators, 0)
        """Requests per operator that were not understood."""
        self._operator_of = {port.link: operator for port, operator in zip(self.ports, operators, strict=True)}
        self._epoch = epoch
        self._policy = policy
        self._answers: dict[str, dict[str, tuple[bytes, bytes]]] = {operator: {} for operator in operators}

    def next_wakeup(self) -> Time | None:
        """It acts on mail only."""
        return None

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Answer every request that arrived."""
        out = Outbox()
        for arrival in inbox:
            self._answer(now, arrival, out)
        return out

    def _answer(self, now: Time, arrival: Arrival, out: Outbox) -> None:
        operator = self._operator_of[arrival.port.link]
        try:
            request = decode_request(arrival.payload)
        except DecodeError as error:
            self._refuse(operator, arrival, Response.error(400, PATH, str(error)), out)
            return
        body = request.body
        if body.operator != operator or operator_of(body.vehicle) != operator:
            message = f"operator {operator!r} asks for {body.vehicle!r} of {body.operator!r}"
            self._refuse(operator, arrival, Response.error(403, request.path, message), out)
            return
        digest = blake2b(arrival.payload, digest_size=16).digest()
        answers = self._answers[operator]
        known = answers.get(body.id)
        if known is not None and known[0] == digest:
            out.send(arrival.port, known[1], (arrival.ref,))
            return
        decision = self._policy.decide(now, request.intent(self._epoch))
        answer = encode(Response.of(body.id, decision, self._epoch))
        answers.pop(body.id, None)
        answers[body.id] = (digest, answer)
        if len(answers) > REMEMBERED:
            del answers[next(iter(answers))]
        kind = "decision.approval_accepted" if decision.accepted else "decision.approval_rejected"
        out.note(kind, body.vehicle, {"intent": body.id, "reason": decision.reason}, (arrival.ref,))
        out.send(arrival.port, answer, (arrival.ref,))

    def _refuse(self, operator: str, arrival: Arrival, response: Response, out: Outbox) -> None:
        count = self.bad_frames[operator] = self.bad_frames[operator] + 1
        if count & (count - 1) == 0:  # powers of two: a flood must not fill the record
            reason = response.body.message if isinstance(response.body, ErrorBody) else ""
            out.note("decision.approval_bad_request", operator, {"count": count, "reason": reason}, (arrival.ref,))
        out.send(arrival.port, encode(response), (arrival.ref,))


def policy_plugin(params: type[Params], make: Callable[[Any], ApprovalPolicy], about: str) -> ApprovalPlugin:
    """An approval that is one service, of an object that decides: `make(params)` returns an `ApprovalPolicy`."""

    def serve(given: Params, context: ApprovalContext) -> ApprovalService:
        service = FlightApproval(context.operators, context.epoch, make(given), name=context.name)
        return ApprovalService([service])

    return ApprovalPlugin(params, serve, about, policy=make)
