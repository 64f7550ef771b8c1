"""Requests of other services to a USS: details of its intents, and notifications of their intents and constraints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from uas_standards.astm.f3548.v21.api import OperationID as Op
from uas_standards.astm.f3548.v21.constants import Scope

from skyrange.codec.f3548.values import ConstraintReference, IntentDetails, IntentReference, volumes_of
from skyrange.contracts.mailboxes import Outbox, Turn
from skyrange.core.errors import DecodeError
from skyrange.core.time import Epoch
from skyrange.utm.contract import OperationalIntent
from skyrange.utm.federated.exchanges import IncomingRequest, Server, file_report
from skyrange.utm.federated.uss.shared_intents import SharedIntents
from skyrange.utm.intent_states import OFF_NOMINAL

_COORDINATION: Final = frozenset({Scope.StrategicCoordination})
_MONITORING: Final = frozenset({Scope.ConformanceMonitoringForSituationalAwareness})
SERVES: Final[Mapping[Op, frozenset[Scope]]] = {
    Op.GetOperationalIntentDetails: _COORDINATION | _MONITORING,
    Op.GetOperationalIntentTelemetry: _MONITORING,
    Op.NotifyOperationalIntentDetailsChanged: _COORDINATION | _MONITORING,
    Op.NotifyConstraintDetailsChanged: frozenset({Scope.ConstraintManagement}),
    Op.GetConstraintDetails: frozenset({Scope.ConstraintProcessing, Scope.ConstraintManagement}),
    Op.MakeUssReport: frozenset(Scope),
}
"""The operations of the standard that a USS has, and the scopes of which a token has to have one."""

_R = TypeVar("_R", bound=ConstraintReference)


@dataclass(slots=True)
class PeerRequests:
    """Answers to the requests of others. Deep-copyable, with the server and the intents that it shares."""

    server: Server
    intents: SharedIntents
    epoch: Epoch

    def answer(self, turn: Turn, request: IncomingRequest) -> OperationalIntent | None:
        """Answer a request; returns the intent of another USS that it was told of."""
        return _HANDLERS[request.operation](self, turn, request)

    def _get_details(self, turn: Turn, request: IncomingRequest) -> None:
        id_ = request.parameters["entityid"]
        reference, intent = self.intents.own.get(id_), self.intents.get(id_)
        if reference is None or intent is None:
            self.server.answer(request, 404, {"message": f"there is no intent {id_}"}, turn.out)
        else:
            self.server.answer(
                request, 200, {"operational_intent": self.intents.describe_own(intent, reference)}, turn.out
            )

    def _get_telemetry(self, turn: Turn, request: IncomingRequest) -> None:
        """Operators report states, not positions: an aircraft outside its volumes has no telemetry here."""
        id_ = request.parameters["entityid"]
        intent = self.intents.get(id_) if id_ in self.intents.own else None
        if intent is None:
            self.server.answer(request, 404, {"message": f"there is no intent {id_}"}, turn.out)
        elif intent.state not in OFF_NOMINAL:
            message = f"the intent is {intent.state.value}: its aircraft is within its volumes"
            self.server.answer(request, 409, {"message": message}, turn.out)
        else:
            self.server.answer(request, 200, {"operational_intent_id": id_}, turn.out)

    def _take_intent_notification(self, turn: Turn, request: IncomingRequest) -> OperationalIntent | None:
        """Another USS has a new version of an intent, or has ended it."""

        def store(reference: IntentReference, details: Mapping[str, Any]) -> None:
            self.intents.store_intent(reference, IntentDetails.of(details, self.epoch))

        return self._take_notification("operational_intent", IntentReference, store, request, turn.out)

    def _take_constraint_notification(self, turn: Turn, request: IncomingRequest) -> OperationalIntent | None:
        """A constraint manager has a new version of a constraint, or has ended it."""

        def store(reference: ConstraintReference, details: Mapping[str, Any]) -> None:
            self.intents.store_constraint(reference, volumes_of(details["volumes"], self.epoch))

        return self._take_notification("constraint", ConstraintReference, store, request, turn.out)

    def _take_notification(
        self,
        kind: str,
        type_: type[_R],
        store: Callable[[_R, Mapping[str, Any]], None],
        request: IncomingRequest,
        out: Outbox,
    ) -> OperationalIntent | None:
        """Know another version of an entity of another service, or know it no more; only its manager may tell."""
        id_, body = request.body[f"{kind}_id"], request.body.get(kind)
        known, manager = self.intents.find_other(id_), request.claims.uss
        is_of_others = known is not None and (known.manager != manager or type(known) is not type_)
        if id_ in self.intents.own or is_of_others:
            self.server.answer(request, 403, {"message": f"{id_} is managed by another USS"}, out)
            return None
        if body is None:
            self.intents.remove_other(id_)
            self.server.answer(request, 204, None, out)
            return None
        try:
            reference = type_.of(body["reference"], self.epoch)
            if (reference.id, reference.manager) != (id_, manager):
                raise DecodeError("the reference is that of another entity, or of another USS")
            if known is None or known.version < reference.version:
                store(reference, body["details"])
        except DecodeError as error:
            self.server.answer(request, 400, {"message": str(error)}, out)
            return None
        self.server.answer(request, 204, None, out)
        return self.intents.get(id_)

    def _get_constraint(self, turn: Turn, request: IncomingRequest) -> None:
        """A USS of operators manages no constraints."""
        self.server.answer(
            request, 404, {"message": f"there is no constraint {request.parameters['entityid']}"}, turn.out
        )

    def _take_report(self, turn: Turn, request: IncomingRequest) -> None:
        self.server.answer(request, 201, file_report(turn, "decision.uss_report", request), turn.out)


_Handler = Callable[[PeerRequests, Turn, IncomingRequest], OperationalIntent | None]
_HANDLERS: Final[Mapping[Op, _Handler]] = {
    Op.GetOperationalIntentDetails: PeerRequests._get_details,
    Op.GetOperationalIntentTelemetry: PeerRequests._get_telemetry,
    Op.NotifyOperationalIntentDetailsChanged: PeerRequests._take_intent_notification,
    Op.NotifyConstraintDetailsChanged: PeerRequests._take_constraint_notification,
    Op.GetConstraintDetails: PeerRequests._get_constraint,
    Op.MakeUssReport: PeerRequests._take_report,
}
