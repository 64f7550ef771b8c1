"""Constraint manager of a federation: publishes areas that are closed to flight, after F3548-21.

It writes a reference of each constraint into the DSS at its time, tells those who have a subscription there, and tells
details to whoever asks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from uas_standards.astm.f3548.v21.api import OperationID as Op
from uas_standards.astm.f3548.v21.constants import Scope

from skyrange.codec.f3548.frames import UssRequest, decode
from skyrange.codec.f3548.values import ConstraintReference, volume_body
from skyrange.contracts.alerts import Scalar
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox, Turn
from skyrange.core.errors import DecodeError
from skyrange.core.ids import Port
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, Epoch, Time
from skyrange.utm.contract import Constraint, Publication
from skyrange.utm.federated.exchanges import (
    Caller,
    Directory,
    IncomingRequest,
    Peer,
    Reply,
    Server,
    WrongReplyError,
    file_report,
)
from skyrange.utm.federated.tokens import TokenChecker, Tokens

SERVICE_NS: Final = 10 * NS_PER_MS
RETRY_NS: Final = 5 * NS_PER_S
"""After which it tries again to publish what the DSS has not accepted; CstrPublishedNotificationLatency."""
SERVES: Final[Mapping[Op, frozenset[Scope]]] = {
    Op.GetConstraintDetails: frozenset({Scope.ConstraintProcessing, Scope.ConstraintManagement}),
    Op.MakeUssReport: frozenset(Scope),
}


class ConstraintManager:
    """The manager as an agent.

    Notes: `decision.constraint_published` about itself, {constraint, subscribers}; `decision.uss_failed` about itself,
    {reason}; `decision.uss_bad_request` about itself.
    """

    def __init__(
        self,
        name: str,
        *,
        dss: Peer,
        directory: Directory,
        base_url: str,
        tokens: Tokens,
        checker: TokenChecker,
        constraints: Sequence[Constraint],
        epoch: Epoch,
    ) -> None:
        """`base_url` is where others reach it."""
        self.name = name
        self.service_ns = SERVICE_NS
        self.ports: Sequence[Port] = (dss.port, *directory.ports)
        self._dss = dss
        self._directory = directory
        self._base_url = base_url
        self._tokens = tokens
        self._epoch = epoch
        self._server = Server(name, checker, SERVES)
        self._caller = Caller()
        self._publication = Publication(constraints)
        self._waiting: dict[str, tuple[Constraint, Time]] = {}
        """Constraints that the DSS has not accepted, and when they are tried again."""
        self._asked: dict[int, str] = {}
        """Ids of constraints by the exchange in which the DSS is asked to accept them."""
        self._published: dict[str, tuple[Constraint, ConstraintReference]] = {}

    @property
    def bad_requests(self) -> int:
        """Frames that were not understood, or refused unseen."""
        return self._server.bad_requests

    def next_wakeup(self) -> Time | None:
        """When a constraint is published, or a call is repeated."""
        times = [self._caller.due, *(due for _, due in self._waiting.values())]
        if self._publication.due is not None:
            times.append(self._publication.due)
        due = min(times)
        return None if due == NEVER else due

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Publish what is due, and answer what arrived."""
        out = Outbox()
        turn = Turn(now, out)
        for arrival in inbox:
            self._on_frame(turn.caused_by(arrival.ref), arrival)
        for call in self._caller.repeat_overdue(turn):
            self._asked.pop(call.exchange, None)
            self._note_failure(turn, f"{call.receiver} does not answer {call.operation.value}")
        for constraint in self._publication.take(now):
            self._waiting[constraint.id] = constraint, now
        for id_, (constraint, due) in list(self._waiting.items()):
            if constraint.volume.end_ns <= now:
                del self._waiting[id_]
            elif due <= now:
                self._waiting[id_] = constraint, now + RETRY_NS
                self._publish(turn, constraint)
        return out

    def _publish(self, turn: Turn, constraint: Constraint) -> None:
        token = self._tokens.get(turn.now, self._dss.name, Scope.ConstraintManagement.value)
        body = {"extents": [volume_body(constraint.volume, self._epoch)], "uss_base_url": self._base_url}
        parameters = {"entityid": constraint.id}
        operation = Op.CreateConstraintReference
        exchange = self._caller.call(turn, self._dss, operation, token=token, parameters=parameters, body=body)
        self._asked[exchange] = constraint.id

    def _on_frame(self, turn: Turn, arrival: Arrival) -> None:
        try:
            frame = decode(arrival.payload)
            if isinstance(frame, UssRequest):
                request = self._server.read(turn, arrival, frame)
                if request is not None:
                    self._answer(turn, request)
                return
            reply = self._caller.read(arrival, frame)
            if reply is not None and reply.call.operation is Op.CreateConstraintReference:
                self._on_published(turn, reply)
        except WrongReplyError as error:
            self._asked.pop(error.call.exchange, None)
            self._server.count_bad(str(error), arrival.ref, turn.out)
            self._note_failure(turn, f"{error.call.receiver} answers {error.call.operation.value} wrongly")
        except DecodeError as error:
            self._server.count_bad(str(error), arrival.ref, turn.out)

    def _answer(self, turn: Turn, request: IncomingRequest) -> None:
        if request.operation is Op.MakeUssReport:
            self._server.answer(request, 201, file_report(turn, "decision.uss_report", request), turn.out)
            return
        published = self._published.get(request.parameters["entityid"])
        if published is None:
            self._server.answer(
                request, 404, {"message": f"there is no constraint {request.parameters['entityid']}"}, turn.out
            )
        else:
            self._server.answer(request, 200, {"constraint": self._shown(*published)}, turn.out)

    def _on_published(self, turn: Turn, reply: Reply) -> None:
        """The DSS has accepted a constraint, or not: one that it refuses is given up, not one that it cannot decide."""
        asked = self._asked.pop(reply.call.exchange, "")
        if reply.status != 201:
            if 400 <= reply.status < 500:
                self._waiting.pop(asked, None)
            self._note_failure(turn, f"DSS: {reply.body.get('message') or f'status {reply.status}'}")
            return
        reference = ConstraintReference.of(reply.body["constraint_reference"], self._epoch)
        if reference.id != asked:
            raise DecodeError("the reference is that of another constraint")
        waiting = self._waiting.pop(asked, None)
        if waiting is None:
            return
        constraint, _ = waiting
        self._published[reference.id] = constraint, reference
        subscribers = reply.body.get("subscribers") or ()
        for subscriber in subscribers:
            peer = self._directory.find(subscriber["uss_base_url"])
            if peer is not None:
                body: dict[str, Any] = {
                    "constraint_id": reference.id,
                    "constraint": self._shown(constraint, reference),
                    "subscriptions": subscriber["subscriptions"],
                }
                token = self._tokens.get(turn.now, peer.name, Scope.ConstraintManagement.value)
                operation = Op.NotifyConstraintDetailsChanged
                self._caller.call(turn, peer, operation, token=token, body=body)
        data: dict[str, Scalar] = {"constraint": constraint.name, "subscribers": len(subscribers)}
        turn.note("decision.constraint_published", self.name, data)

    def _shown(self, constraint: Constraint, reference: ConstraintReference) -> dict[str, Any]:
        details = {"volumes": [volume_body(constraint.volume, self._epoch)], "type": constraint.name}
        return {"reference": reference.body(self._epoch), "details": details}

    def _note_failure(self, turn: Turn, reason: str) -> None:
        turn.caused_by().note("decision.uss_failed", self.name, {"reason": reason[:256]})
