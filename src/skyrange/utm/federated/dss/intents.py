"""Operations of a DSS on references of operational intents."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from uas_standards.astm.f3548.v21.api import OperationalIntentState as State
from uas_standards.astm.f3548.v21.api import OperationID as Op
from uas_standards.astm.f3548.v21.api import UssAvailabilityState
from uas_standards.astm.f3548.v21.constants import Scope

from skyrange.codec.f3548.values import NO_SUBSCRIPTION, IntentReference
from skyrange.contracts.mailboxes import Turn
from skyrange.core.time import Time
from skyrange.utm.federated.dss.coverings import Extent
from skyrange.utm.federated.dss.requests import DssState, Handler, RefusalError, check_version, requested_ovn
from skyrange.utm.federated.dss.store import StoredIntent, Subscription
from skyrange.utm.federated.exchanges import IncomingRequest

NOMINAL: Final = frozenset({State.Accepted, State.Activated})
"""States that need a key."""


def _query(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    stored = dss.store.intents_in(dss.area(request))
    return 200, {
        "operational_intent_references": [dss.describe_reference(intent, request.claims.uss) for intent in stored]
    }


def _get(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    return 200, {
        "operational_intent_reference": dss.describe_reference(_stored_intent(dss, request), request.claims.uss)
    }


def _put(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    body, uss, id_ = request.body, request.claims.uss, request.parameters["entityid"]
    ovn, state = request.parameters.get("ovn"), body["state"]
    if ovn is None and state is not State.Accepted:
        raise RefusalError(400, f"the first version of an intent is Accepted, not {state.value}")
    extent = dss.extent(turn.now, body["extents"], heights=True)
    _check_subscription_fields(body, state)
    suffix = body.get("requested_ovn_suffix")
    wanted_ovn = None if suffix is None else requested_ovn(turn.now, dss.epoch, id_, suffix)
    needed = Scope.StrategicCoordination if state in NOMINAL else Scope.ConformanceMonitoringForSituationalAwareness
    if not request.has(needed):
        raise RefusalError(403, f"state {state.value} needs the scope {needed.value}")
    old = dss.store.intent(id_)
    check_version("intent", uss, old.reference if old is not None else None, ovn, missing=400)
    version = 1 if old is None else old.reference.version + 1
    subscription = _find_subscription(dss, turn.now, request, extent, version)
    if state in NOMINAL:
        _check_key(dss, turn, request, extent, subscription)
    if subscription is not None:
        dss.store.put_subscription(subscription)
    reference = IntentReference(
        id=id_,
        manager=uss,
        version=version,
        state=state,
        ovn=wanted_ovn or dss.make_ovn(id_, version, turn.now),
        start_ns=extent.start_ns,
        end_ns=extent.end_ns,
        uss_base_url=body["uss_base_url"],
        subscription_id=NO_SUBSCRIPTION if subscription is None else subscription.id,
    )
    stored = StoredIntent(reference, extent)
    dss.store.put_intent(stored)
    if old is not None and old.reference.subscription_id != reference.subscription_id:
        _release(dss, old.reference.subscription_id)
    turn.note("decision.dss_accepted", uss, {"intent": id_, "state": state.value, "version": version})
    return (201 if old is None else 200), _describe_change(
        dss, stored, extent if old is None else extent.joined(old.extent)
    )


def _delete(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    stored = _stored_intent(dss, request)
    check_version("intent", request.claims.uss, stored.reference, request.parameters["ovn"], missing=404)
    dss.store.delete_intent(stored.id)
    body = _describe_change(dss, stored, stored.extent)
    _release(dss, stored.reference.subscription_id)
    return 200, body


def _describe_change(dss: DssState, stored: StoredIntent, extent: Extent) -> dict[str, Any]:
    """The response to its manager, with the subscribers that it has to notify."""
    subscriptions = [
        subscription
        for subscription in dss.store.subscriptions_in(extent)
        if subscription.notify_for_operational_intents
    ]
    return {
        "subscribers": dss.notify(subscriptions),
        "operational_intent_reference": dss.describe_reference(stored, stored.reference.manager),
    }


def _stored_intent(dss: DssState, request: IncomingRequest) -> StoredIntent:
    stored = dss.store.intent(request.parameters["entityid"])
    if stored is None:
        raise RefusalError(404, f"there is no intent {request.parameters['entityid']}")
    return stored


def _check_key(
    dss: DssState, turn: Turn, request: IncomingRequest, extent: Extent, subscription: Subscription | None
) -> None:
    """Refuse an intent whose USS does not know the current version of everything that may be in the way."""
    uss, id_ = request.claims.uss, request.parameters["entityid"]
    key, state = frozenset(request.body.get("key") or ()), request.body["state"]
    intents = [
        intent
        for intent in dss.store.intents_in(extent)
        if intent.id != id_ and intent.reference.ovn not in key and _requires_key(dss, intent)
    ]
    processes = subscription is not None and subscription.notify_for_constraints
    candidates = dss.store.constraints_in(extent) if processes else ()
    constraints = [constraint for constraint in candidates if constraint.reference.ovn not in key]
    if not intents and not constraints:
        return
    data = {"intent": id_, "state": state.value, "missing": len(intents) + len(constraints)}
    turn.note("decision.dss_conflict", uss, data)
    more: dict[str, Any] = {"missing_operational_intents": [dss.describe_reference(intent, uss) for intent in intents]}
    if constraints:
        more["missing_constraints"] = [dss.describe_reference(constraint, uss) for constraint in constraints]
    raise RefusalError(409, "the key lacks the OVNs of some intents or constraints", more)


def _requires_key(dss: DssState, stored: StoredIntent) -> bool:
    """Whether others have to know an intent: not if it is Accepted and its USS is down, hence cannot be asked."""
    is_down = dss.store.availability(stored.reference.manager).state is UssAvailabilityState.Down
    return not (is_down and stored.reference.state is State.Accepted)


def _check_subscription_fields(body: Mapping[str, Any], state: State) -> None:
    given, wanted = body.get("subscription_id"), body.get("new_subscription")
    if given and wanted is not None:
        raise RefusalError(400, "give either subscription_id or new_subscription")
    if not given and wanted is None and state is not State.Accepted:
        raise RefusalError(400, f"state {state.value} needs subscription_id or new_subscription")
    if wanted is not None and not wanted["uss_base_url"]:
        raise RefusalError(400, "new_subscription: it needs uss_base_url")


def _find_subscription(
    dss: DssState, now: Time, request: IncomingRequest, extent: Extent, version: int
) -> Subscription | None:
    """The subscription that an intent is to have: a new one, one that exists, widened where it is implicit, or none."""
    id_, wanted = request.body.get("subscription_id"), request.body.get("new_subscription")
    if wanted is not None:
        subscription = dss.renewed_uuid("implicit subscription", request.parameters["entityid"], version, now)
        return Subscription(
            subscription,
            request.claims.uss,
            wanted["uss_base_url"],
            extent,
            version=dss.renewed_uuid("version", subscription, "", now),
            is_implicit=True,
            notify_for_constraints=bool(wanted.get("notify_for_constraints")),
        )
    if not id_:
        return None
    existing = dss.store.subscription(id_)
    if existing is None:
        raise RefusalError(400, f"there is no subscription {id_}")
    if existing.manager != request.claims.uss:
        raise RefusalError(403, "the subscription belongs to another USS")
    if not existing.extent.covers(extent):
        if not existing.is_implicit:
            raise RefusalError(400, "the subscription does not cover the intent")
        renewed = dss.renewed_uuid("version", existing.id, existing.version, now)
        return replace(existing, extent=existing.extent.joined(extent), version=renewed)
    return existing


def _release(dss: DssState, subscription: str) -> None:
    """End an implicit subscription that no intent has any more."""
    existing = dss.store.subscription(subscription)
    if existing is not None and existing.is_implicit and not dss.store.dependents(subscription):
        dss.store.delete_subscription(subscription)


HANDLERS: Final[Mapping[Op, Handler]] = {
    Op.QueryOperationalIntentReferences: _query,
    Op.GetOperationalIntentReference: _get,
    Op.CreateOperationalIntentReference: _put,
    Op.UpdateOperationalIntentReference: _put,
    Op.DeleteOperationalIntentReference: _delete,
}
