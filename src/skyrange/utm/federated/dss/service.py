"""Discovery and synchronization service (DSS) of a federation: which USS manages an intent where, and whom to tell.

It knows references and extents, not volumes, and approves nothing: it accepts a nominal intent if its USS proves with a
key of OVNs that it knows every intent that may be in the way (F3548-21, DSS0005 and following).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from uas_standards.astm.f3548.v21.api import OperationID as Op
from uas_standards.astm.f3548.v21.constants import Scope

from skyrange.codec.f3548.frames import UssRequest, decode
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox, Turn
from skyrange.core.errors import DecodeError
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, Epoch, Time
from skyrange.utm.federated.dss import constraints, intents, subscriptions
from skyrange.utm.federated.dss.coverings import AreaError
from skyrange.utm.federated.dss.requests import DssState, Handler, RefusalError
from skyrange.utm.federated.dss.store import Availability, DssStore
from skyrange.utm.federated.exchanges import IncomingRequest, Server, file_report
from skyrange.utm.federated.tokens import TokenChecker

SERVICE_NS: Final = 10 * NS_PER_MS
_COORDINATION: Final = frozenset({Scope.StrategicCoordination})
_MONITORING: Final = _COORDINATION | {Scope.ConformanceMonitoringForSituationalAwareness}
_PROCESSING: Final = frozenset({Scope.ConstraintProcessing})
_MANAGEMENT: Final = frozenset({Scope.ConstraintManagement})
SERVES: Final[Mapping[Op, frozenset[Scope]]] = {
    Op.QueryOperationalIntentReferences: _MONITORING,
    Op.GetOperationalIntentReference: _MONITORING,
    Op.CreateOperationalIntentReference: _MONITORING,
    Op.UpdateOperationalIntentReference: _MONITORING,
    Op.DeleteOperationalIntentReference: _MONITORING,
    Op.QueryConstraintReferences: _MANAGEMENT | _PROCESSING,
    Op.GetConstraintReference: _MANAGEMENT | _PROCESSING,
    Op.CreateConstraintReference: _MANAGEMENT,
    Op.UpdateConstraintReference: _MANAGEMENT,
    Op.DeleteConstraintReference: _MANAGEMENT,
    Op.QuerySubscriptions: _COORDINATION | _PROCESSING,
    Op.GetSubscription: _COORDINATION | _PROCESSING,
    Op.CreateSubscription: _COORDINATION | _PROCESSING,
    Op.UpdateSubscription: _COORDINATION | _PROCESSING,
    Op.DeleteSubscription: _COORDINATION | _PROCESSING,
    Op.GetUssAvailability: frozenset(Scope),
    Op.SetUssAvailability: frozenset({Scope.AvailabilityArbitration}),
    Op.MakeDssReport: frozenset(Scope),
}
"""The operations of the standard, and the scopes of which a token has to have one."""


class Dss:
    """A DSS as an agent.

    Notes: `decision.dss_accepted` and `decision.dss_conflict` about the USS, {intent, state, missing};
    `decision.dss_constraint` about the USS, {constraint, version}; `decision.uss_bad_request` about itself.
    """

    def __init__(
        self,
        name: str,
        ports: Sequence[Port],
        tokens: TokenChecker,
        secret: bytes,
        epoch: Epoch,
        store: DssStore | None = None,
    ) -> None:
        """`ports`: one for each USS; `secret` makes OVNs that nobody can guess."""
        self.name = name
        self.service_ns = SERVICE_NS
        self.ports: Sequence[Port] = tuple(ports)
        self._server = Server(name, tokens, SERVES)
        self._state = DssState(name, secret, epoch, store or DssStore())

    @property
    def bad_requests(self) -> int:
        """Frames that were not understood, or refused unseen."""
        return self._server.bad_requests

    @property
    def store(self) -> DssStore:
        """Its entities."""
        return self._state.store

    def next_wakeup(self) -> Time | None:
        """It acts on mail only."""
        return None

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Answer every request that arrived."""
        out = Outbox()
        self._state.store.forget(now)
        for arrival in inbox:
            self._answer(Turn(now, out, (arrival.ref,)), arrival)
        return out

    def _answer(self, turn: Turn, arrival: Arrival) -> None:
        try:
            frame = decode(arrival.payload)
        except DecodeError as error:
            self._server.refuse(arrival, 0, 400, str(error), turn.out)
            return
        if not isinstance(frame, UssRequest):
            self._server.count_bad("a response that nobody asked for", arrival.ref, turn.out)
            return
        request = self._server.read(turn, arrival, frame)
        if request is None:
            return
        try:
            status, body = _HANDLERS[request.operation](self._state, turn, request)
        except RefusalError as refusal:
            self._server.answer(request, refusal.status, refusal.body, turn.out)
        except DecodeError as error:
            self._server.answer(request, 400, {"message": str(error)}, turn.out)
        except AreaError as error:
            self._server.answer(request, 413, {"message": str(error)}, turn.out)
        else:
            self._server.answer(request, status, body, turn.out)


def _get_availability(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    return 200, _availability(dss, request.parameters["uss_id"])


def _set_availability(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    uss = request.parameters["uss_id"]
    version = dss.store.availability(uss).version
    if (request.body.get("old_version") or "") != version:
        raise RefusalError(409, "old_version is not the current one")
    renewed = dss.renewed_uuid("availability", uss, version, turn.now)
    dss.store.put_availability(Availability(uss, request.body["availability"], renewed))
    return 200, _availability(dss, uss)


def _availability(dss: DssState, uss: str) -> dict[str, Any]:
    stored = dss.store.availability(uss)
    return {"version": stored.version, "status": {"uss": uss, "availability": stored.state.value}}


def _report(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    return 201, file_report(turn, "decision.dss_report", request)


_HANDLERS: Final[Mapping[Op, Handler]] = {
    **intents.HANDLERS,
    **constraints.HANDLERS,
    **subscriptions.HANDLERS,
    Op.GetUssAvailability: _get_availability,
    Op.SetUssAvailability: _set_availability,
    Op.MakeDssReport: _report,
}
