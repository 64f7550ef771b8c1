"""Discovery and synchronization service (DSS) of a federation: which USS manages an intent where, and whom to tell.

It knows references and extents, not volumes, and approves nothing: it accepts a nominal intent if its USS proves with a
key of OVNs that it knows every intent that may be in the way (F3548-21, DSS0005 and following).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from hashlib import blake2b
from typing import Any, Final

from uas_standards.astm.f3548.v21.api import OperationalIntentState as State
from uas_standards.astm.f3548.v21.api import OperationID as Op
from uas_standards.astm.f3548.v21.api import UssAvailabilityState
from uas_standards.astm.f3548.v21.constants import Scope

from skyrange.codec.f3548.frames import UssRequest, decode
from skyrange.codec.f3548.values import HIDDEN_OVN, NO_SUBSCRIPTION, IntentReference, volume_of, volumes_of
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.core.errors import DecodeError
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, Epoch, Time
from skyrange.utm.contract import make_uuid
from skyrange.utm.federated.coverings import AreaError, Extent, extent_of
from skyrange.utm.federated.dss_store import DssStore, StoredIntent, Subscription
from skyrange.utm.federated.exchanges import Asked, Server, file_report
from skyrange.utm.federated.tokens import TokenChecker

SERVICE_NS: Final = 10 * NS_PER_MS
_COORDINATION: Final = frozenset({Scope.StrategicCoordination})
_COORDINATION_OR_MONITORING: Final = _COORDINATION | {Scope.ConformanceMonitoringForSituationalAwareness}
_ANY: Final = frozenset(Scope)
SERVES: Final[Mapping[Op, frozenset[Scope]]] = {
    Op.QueryOperationalIntentReferences: _COORDINATION_OR_MONITORING,
    Op.GetOperationalIntentReference: _COORDINATION_OR_MONITORING,
    Op.CreateOperationalIntentReference: _COORDINATION_OR_MONITORING,
    Op.UpdateOperationalIntentReference: _COORDINATION_OR_MONITORING,
    Op.DeleteOperationalIntentReference: _COORDINATION_OR_MONITORING,
    Op.QuerySubscriptions: _COORDINATION | {Scope.ConstraintProcessing},
    Op.GetSubscription: _COORDINATION | {Scope.ConstraintProcessing},
    Op.CreateSubscription: _COORDINATION | {Scope.ConstraintProcessing},
    Op.UpdateSubscription: _COORDINATION | {Scope.ConstraintProcessing},
    Op.DeleteSubscription: _COORDINATION | {Scope.ConstraintProcessing},
    Op.GetUssAvailability: _ANY,
    Op.SetUssAvailability: frozenset({Scope.AvailabilityArbitration}),
    Op.MakeDssReport: _ANY,
}
"""The operations of the standard that it has, and the scopes of which a token has to have one."""
NOMINAL: Final = frozenset({State.Accepted, State.Activated})
"""States that need a key."""


class RefusalError(Exception):
    """A request that changes nothing."""

    def __init__(self, status: int, message: str, more: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.status = status
        self.body = {"message": message, **(more or {})}


class Dss:
    """A DSS as an agent.

    Notes: `decision.dss_accepted` and `decision.dss_conflict` about the USS, {intent, state, missing};
    `decision.uss_bad_request` about itself.
    """

    def __init__(self, name: str, ports: Sequence[Port], tokens: TokenChecker, secret: bytes, epoch: Epoch) -> None:
        """`ports`: one for each USS; `secret` makes OVNs that nobody can guess."""
        self.name = name
        self.service_ns = SERVICE_NS
        self.ports: Sequence[Port] = tuple(ports)
        self._server = Server(name, tokens, SERVES)
        self._secret = secret
        self._epoch = epoch
        self._store = DssStore()
        self._created = 0
        """Subscriptions that were made with intents."""

    @property
    def bad_requests(self) -> int:
        """Frames that were not understood, or refused unseen."""
        return self._server.bad_requests

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
        try:
            frame = decode(arrival.payload)
        except DecodeError as error:
            self._server.refuse(arrival, 0, 400, str(error), out)
            return
        if not isinstance(frame, UssRequest):
            self._server.count_bad("a response that nobody asked for", arrival.ref, out)
            return
        asked = self._server.read(now, arrival, frame, out)
        if asked is None:
            return
        try:
            status, body = _HANDLERS[asked.operation](self, now, asked, out)
        except RefusalError as refusal:
            self._server.answer(asked, refusal.status, refusal.body, out)
        except DecodeError as error:
            self._server.answer(asked, 400, {"message": str(error)}, out)
        except AreaError as error:
            self._server.answer(asked, 413, {"message": str(error)}, out)
        else:
            self._server.answer(asked, status, body, out)

    # --- operational intents -------------------------------------------------------------------------------

    def _query_intents(self, now: Time, asked: Asked, out: Outbox) -> tuple[int, Any]:
        found = self._store.intents_in(self._area(asked))
        return 200, {"operational_intent_references": [self._shown(one, asked.claims.uss) for one in found]}

    def _get_intent(self, now: Time, asked: Asked, out: Outbox) -> tuple[int, Any]:
        stored = self._stored(asked)
        return 200, {"operational_intent_reference": self._shown(stored, asked.claims.uss)}

    def _put_intent(self, now: Time, asked: Asked, out: Outbox) -> tuple[int, Any]:
        body, uss, id_ = asked.body, asked.claims.uss, asked.parameters["entityid"]
        ovn = asked.parameters.get("ovn")
        old = self._store.intent(id_)
        state: State = body["state"]
        self._check_version(uss, old, ovn)
        if old is None and state is not State.Accepted:
            raise RefusalError(400, f"the first version of an intent is Accepted, not {state.value}")
        needed = Scope.StrategicCoordination if state in NOMINAL else Scope.ConformanceMonitoringForSituationalAwareness
        if not asked.has(needed):
            raise RefusalError(403, f"state {state.value} needs the scope {needed.value}")
        volumes = volumes_of(body["extents"], self._epoch)
        if not volumes:
            raise RefusalError(400, "extents: at least one volume is needed")
        extent = extent_of(volumes)
        if extent.end_ns <= now:
            raise RefusalError(400, "extents: all are over")
        known = frozenset(body.get("key") or ())
        subscribed = self._find_subscription(asked, extent)
        if state in NOMINAL:
            self._check_key(id_, uss, extent, known, state, out, asked)
        subscription = self._subscribe(subscribed, asked, extent, old, state)
        version = 1 if old is None else old.reference.version + 1
        reference = IntentReference(
            id_,
            uss,
            version,
            state,
            self._make_ovn(id_, version, volumes),
            extent.start_ns,
            extent.end_ns,
            body["uss_base_url"],
            subscription,
        )
        stored = StoredIntent(reference, extent)
        self._store.put_intent(stored)
        if old is not None and old.reference.subscription_id != subscription:
            self._release(old.reference.subscription_id)
        out.note("decision.dss_accepted", uss, {"intent": id_, "state": state.value, "version": version}, (asked.ref,))
        changed = extent if old is None else extent.joined(old.extent)
        body = {
            "subscribers": self._notify(changed),
            "operational_intent_reference": self._shown(stored, uss),
        }
        return (201 if old is None else 200), body

    def _delete_intent(self, now: Time, asked: Asked, out: Outbox) -> tuple[int, Any]:
        stored = self._stored(asked)
        uss = asked.claims.uss
        self._check_version(uss, stored, asked.parameters["ovn"])
        self._store.delete_intent(stored.id)
        subscribers = self._notify(stored.extent)
        self._release(stored.reference.subscription_id)
        return 200, {"subscribers": subscribers, "operational_intent_reference": self._shown(stored, uss)}

    def _check_version(self, uss: str, old: StoredIntent | None, ovn: str | None) -> None:
        if old is None:
            if ovn is not None:
                raise RefusalError(404, f"there is no intent, and none of version {ovn}")
        elif old.reference.manager != uss:
            raise RefusalError(403, "the intent is managed by another USS")
        elif old.reference.ovn != ovn:
            raise RefusalError(409, "the OVN is not that of the current version")

    def _check_key(
        self, id_: str, uss: str, extent: Extent, key: frozenset[str], state: State, out: Outbox, asked: Asked
    ) -> None:
        missing = [
            one
            for one in self._store.intents_in(extent)
            if one.id != id_ and one.reference.ovn not in key and self._requires_key(one)
        ]
        if not missing:
            return
        data = {"intent": id_, "state": state.value, "missing": len(missing)}
        out.note("decision.dss_conflict", uss, data, (asked.ref,))
        raise RefusalError(
            409,
            "the key lacks the OVNs of some intents",
            {"missing_operational_intents": [self._shown(one, uss) for one in missing]},
        )

    def _requires_key(self, stored: StoredIntent) -> bool:
        """Whether others have to know an intent: not if it is Accepted and its USS is down, hence cannot be asked."""
        is_down = self._store.availability(stored.reference.manager)[0] is UssAvailabilityState.Down
        return not (is_down and stored.reference.state is State.Accepted)

    def _make_ovn(self, id_: str, version: int, volumes: object) -> str:
        return blake2b(f"{id_} {version} {volumes}".encode(), key=self._secret, digest_size=16).hexdigest()

    def _shown(self, stored: StoredIntent, uss: str) -> dict[str, Any]:
        """A reference as a USS sees it."""
        reference = replace(stored.reference, uss_availability=self._store.availability(stored.reference.manager)[0])
        if reference.manager != uss:
            reference = replace(reference, ovn=HIDDEN_OVN)
        return reference.body(self._epoch)

    def _stored(self, asked: Asked) -> StoredIntent:
        stored = self._store.intent(asked.parameters["entityid"])
        if stored is None:
            raise RefusalError(404, f"there is no intent {asked.parameters['entityid']}")
        return stored

    def _area(self, asked: Asked) -> Extent:
        area = asked.body.get("area_of_interest")
        if area is None:
            raise RefusalError(400, "area_of_interest: it is needed")
        return extent_of([volume_of(area, self._epoch, "area_of_interest")])

    # --- subscriptions -------------------------------------------------------------------------------------

    def _find_subscription(self, asked: Asked, extent: Extent) -> Subscription | None:
        """The subscription that a request names, widened where it is implicit. Raises `RefusalError`."""
        id_ = asked.body.get("subscription_id")
        if not id_ or id_ == NO_SUBSCRIPTION:
            return None
        if asked.body.get("new_subscription") is not None:
            raise RefusalError(400, "give either subscription_id or new_subscription")
        found = self._store.subscription(id_)
        if found is None:
            raise RefusalError(400, f"there is no subscription {id_}")
        if found.manager != asked.claims.uss:
            raise RefusalError(403, "the subscription belongs to another USS")
        joined = found.extent.joined(extent)
        if joined == found.extent:
            return found
        if not found.is_implicit:
            raise RefusalError(400, "the subscription does not cover the intent")
        return replace(found, extent=joined)

    def _subscribe(
        self, found: Subscription | None, asked: Asked, extent: Extent, old: StoredIntent | None, state: State
    ) -> str:
        """The id of the subscription that the intent has from now on, made anew if asked for."""
        wanted = asked.body.get("new_subscription")
        if found is not None:
            self._store.put_subscription(found)
            return found.id
        if wanted is None:
            if state is not State.Accepted:
                raise RefusalError(400, f"state {state.value} needs subscription_id or new_subscription")
            return NO_SUBSCRIPTION
        self._created += 1
        made = Subscription(
            make_uuid(f"implicit subscription {self._created} of {self.name}"),
            asked.claims.uss,
            wanted["uss_base_url"],
            extent,
            version=make_uuid(f"version {self._created} of {self.name}"),
            is_implicit=True,
            notify_for_constraints=bool(wanted.get("notify_for_constraints")),
        )
        self._store.put_subscription(made)
        return made.id

    def _release(self, id_: str) -> None:
        """End an implicit subscription that no intent has any more."""
        found = self._store.subscription(id_)
        if found is not None and found.is_implicit and not self._store.dependents(id_):
            self._store.delete_subscription(id_)

    def _notify(self, extent: Extent) -> list[dict[str, Any]]:
        """Count a notification of each subscription to intents in an extent: whom the USS has to tell."""
        told: dict[str, list[dict[str, Any]]] = {}
        for one in list(self._store.subscriptions_in(extent)):
            if one.notify_for_operational_intents:
                counted = replace(one, notification_index=one.notification_index + 1)
                self._store.put_subscription(counted)
                state = {"subscription_id": one.id, "notification_index": counted.notification_index}
                told.setdefault(one.uss_base_url, []).append(state)
        return [{"uss_base_url": url, "subscriptions": states} for url, states in sorted(told.items())]

    def _query_subscriptions(self, now: Time, asked: Asked, out: Outbox) -> tuple[int, Any]:
        found = self._store.subscriptions_in(self._area(asked))
        return 200, {"subscriptions": [self._subscription(one) for one in found if one.manager == asked.claims.uss]}

    def _get_subscription(self, now: Time, asked: Asked, out: Outbox) -> tuple[int, Any]:
        return 200, {"subscription": self._subscription(self._own_subscription(asked))}

    def _put_subscription(self, now: Time, asked: Asked, out: Outbox) -> tuple[int, Any]:
        body, id_ = asked.body, asked.parameters["subscriptionid"]
        old = self._store.subscription(id_)
        version = asked.parameters.get("version")
        if (old is None) != (version is None):
            raise RefusalError(404 if old is None else 409, "there is no such version of the subscription")
        if old is not None:
            self._own_subscription(asked)
        if not (body.get("notify_for_operational_intents") or body.get("notify_for_constraints")):
            raise RefusalError(400, "a subscription is for operational intents, constraints or both")
        extent = extent_of([volume_of(body["extents"], self._epoch, "extents")])
        if extent.end_ns <= now:
            raise RefusalError(400, "extents: the time is over")
        made = Subscription(
            id_,
            asked.claims.uss,
            body["uss_base_url"],
            extent,
            version=make_uuid(f"{id_} {version}"),
            notification_index=old.notification_index if old is not None else 0,
            is_implicit=old is not None and old.is_implicit,
            notify_for_operational_intents=bool(body.get("notify_for_operational_intents")),
            notify_for_constraints=bool(body.get("notify_for_constraints")),
        )
        self._store.put_subscription(made)
        found: Iterable[StoredIntent] = self._store.intents_in(extent) if made.notify_for_operational_intents else ()
        return 200, {
            "subscription": self._subscription(made),
            "operational_intent_references": [self._shown(one, made.manager) for one in found],
        }

    def _delete_subscription(self, now: Time, asked: Asked, out: Outbox) -> tuple[int, Any]:
        found = self._own_subscription(asked)
        if self._store.dependents(found.id):
            raise RefusalError(400, "an operational intent has this subscription")
        self._store.delete_subscription(found.id)
        return 200, {"subscription": self._subscription(found)}

    def _own_subscription(self, asked: Asked) -> Subscription:
        found = self._store.subscription(asked.parameters["subscriptionid"])
        if found is None:
            raise RefusalError(404, f"there is no subscription {asked.parameters['subscriptionid']}")
        if found.manager != asked.claims.uss:
            raise RefusalError(403, "the subscription belongs to another USS")
        if asked.parameters.get("version", found.version) != found.version:
            raise RefusalError(409, "the version is not the current one")
        return found

    def _subscription(self, one: Subscription) -> dict[str, Any]:
        moments = (one.extent.start_ns, False), (one.extent.end_ns, True)
        start, end = ({"value": self._epoch.rfc3339(time, up=up), "format": "RFC3339"} for time, up in moments)
        return {
            "id": one.id,
            "version": one.version,
            "notification_index": one.notification_index,
            "time_start": start,
            "time_end": end,
            "uss_base_url": one.uss_base_url,
            "notify_for_operational_intents": one.notify_for_operational_intents,
            "notify_for_constraints": one.notify_for_constraints,
            "implicit_subscription": one.is_implicit,
            "dependent_operational_intents": self._store.dependents(one.id),
        }

    # --- availability, reports -----------------------------------------------------------------------------

    def _get_availability(self, now: Time, asked: Asked, out: Outbox) -> tuple[int, Any]:
        return 200, self._availability(asked.parameters["uss_id"])

    def _set_availability(self, now: Time, asked: Asked, out: Outbox) -> tuple[int, Any]:
        uss = asked.parameters["uss_id"]
        version = self._store.availability(uss)[1]
        if (asked.body.get("old_version") or "") != version:
            raise RefusalError(409, "old_version is not the current one")
        self._store.set_availability(uss, asked.body["availability"], make_uuid(f"{uss} {version}"))
        return 200, self._availability(uss)

    def _availability(self, uss: str) -> dict[str, Any]:
        state, version = self._store.availability(uss)
        return {"version": version, "status": {"uss": uss, "availability": state.value}}

    def _report(self, now: Time, asked: Asked, out: Outbox) -> tuple[int, Any]:
        return 201, file_report("decision.dss_report", now, asked, out)


_Handler = Callable[[Dss, Time, Asked, Outbox], tuple[int, Any]]
_HANDLERS: Final[Mapping[Op, _Handler]] = {
    Op.QueryOperationalIntentReferences: Dss._query_intents,
    Op.GetOperationalIntentReference: Dss._get_intent,
    Op.CreateOperationalIntentReference: Dss._put_intent,
    Op.UpdateOperationalIntentReference: Dss._put_intent,
    Op.DeleteOperationalIntentReference: Dss._delete_intent,
    Op.QuerySubscriptions: Dss._query_subscriptions,
    Op.GetSubscription: Dss._get_subscription,
    Op.CreateSubscription: Dss._put_subscription,
    Op.UpdateSubscription: Dss._put_subscription,
    Op.DeleteSubscription: Dss._delete_subscription,
    Op.GetUssAvailability: Dss._get_availability,
    Op.SetUssAvailability: Dss._set_availability,
    Op.MakeDssReport: Dss._report,
}
