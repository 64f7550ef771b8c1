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
from skyrange.utm.federated.exchanges import Asked, Server, file_report
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

    def answer(self, turn: Turn, asked: Asked) -> OperationalIntent | None:
        """Answer a request; returns the intent of another USS that it was told of."""
        return _HANDLERS[asked.operation](self, turn, asked)

    def _get_details(self, turn: Turn, asked: Asked) -> None:
        id_ = asked.parameters["entityid"]
        own, intent = self.intents.own.get(id_), self.intents.get(id_)
        if own is None or intent is None:
            self.server.answer(asked, 404, {"message": f"there is no intent {id_}"}, turn.out)
        else:
            self.server.answer(asked, 200, {"operational_intent": self.intents.show(intent, own)}, turn.out)

    def _get_telemetry(self, turn: Turn, asked: Asked) -> None:
        """Operators report states, not positions: an aircraft outside its volumes has no telemetry here."""
        id_ = asked.parameters["entityid"]
        own = self.intents.get(id_) if id_ in self.intents.own else None
        if own is None:
            self.server.answer(asked, 404, {"message": f"there is no intent {id_}"}, turn.out)
        elif own.state not in OFF_NOMINAL:
            message = f"the intent is {own.state.value}: its aircraft is within its volumes"
            self.server.answer(asked, 409, {"message": message}, turn.out)
        else:
            self.server.answer(asked, 200, {"operational_intent_id": id_}, turn.out)

    def _take_intent_notification(self, turn: Turn, asked: Asked) -> OperationalIntent | None:
        """Another USS has a new version of an intent, or has ended it."""

        def learn(reference: IntentReference, details: Mapping[str, Any]) -> None:
            self.intents.learn(reference, IntentDetails.of(details, self.epoch))

        return self._take_notification("operational_intent", IntentReference, learn, asked, turn.out)

    def _take_constraint_notification(self, turn: Turn, asked: Asked) -> OperationalIntent | None:
        """A constraint manager has a new version of a constraint, or has ended it."""

        def learn(reference: ConstraintReference, details: Mapping[str, Any]) -> None:
            self.intents.learn_constraint(reference, volumes_of(details["volumes"], self.epoch))

        return self._take_notification("constraint", ConstraintReference, learn, asked, turn.out)

    def _take_notification(
        self, kind: str, type_: type[_R], learn: Callable[[_R, Mapping[str, Any]], None], asked: Asked, out: Outbox
    ) -> OperationalIntent | None:
        """Know another version of an entity of another service, or know it no more; only its manager may tell."""
        id_, body = asked.body[f"{kind}_id"], asked.body.get(kind)
        known, manager = self.intents.other(id_), asked.claims.uss
        is_of_others = known is not None and (known.manager != manager or type(known) is not type_)
        if id_ in self.intents.own or is_of_others:
            self.server.answer(asked, 403, {"message": f"{id_} is managed by another USS"}, out)
            return None
        if body is None:
            self.intents.lose(id_)
            self.server.answer(asked, 204, None, out)
            return None
        try:
            reference = type_.of(body["reference"], self.epoch)
            if (reference.id, reference.manager) != (id_, manager):
                raise DecodeError("the reference is that of another entity, or of another USS")
            if known is None or known.version < reference.version:
                learn(reference, body["details"])
        except DecodeError as error:
            self.server.answer(asked, 400, {"message": str(error)}, out)
            return None
        self.server.answer(asked, 204, None, out)
        return self.intents.get(id_)

    def _get_constraint(self, turn: Turn, asked: Asked) -> None:
        """A USS of operators manages no constraints."""
        self.server.answer(asked, 404, {"message": f"there is no constraint {asked.parameters['entityid']}"}, turn.out)

    def _take_report(self, turn: Turn, asked: Asked) -> None:
        self.server.answer(asked, 201, file_report(turn, "decision.uss_report", asked), turn.out)


_Handler = Callable[[PeerRequests, Turn, Asked], OperationalIntent | None]
_HANDLERS: Final[Mapping[Op, _Handler]] = {
    Op.GetOperationalIntentDetails: PeerRequests._get_details,
    Op.GetOperationalIntentTelemetry: PeerRequests._get_telemetry,
    Op.NotifyOperationalIntentDetailsChanged: PeerRequests._take_intent_notification,
    Op.NotifyConstraintDetailsChanged: PeerRequests._take_constraint_notification,
    Op.GetConstraintDetails: PeerRequests._get_constraint,
    Op.MakeUssReport: PeerRequests._take_report,
}
