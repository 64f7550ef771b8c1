"""Operations of a DSS on subscriptions: who wants to be told of changes in an area."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from uas_standards.astm.f3548.v21.api import OperationID as Op

from skyrange.codec.f3548.values import area_of, moment_body
from skyrange.contracts.mailboxes import Turn
from skyrange.core.time import NS_PER_S, NS_PER_US, Time
from skyrange.utm.federated.dss.coverings import Extent, extent_of
from skyrange.utm.federated.dss.requests import MAX_SKEW_NS, DssState, Handler, RefusalError
from skyrange.utm.federated.dss.store import Subscription
from skyrange.utm.federated.exchanges import IncomingRequest

MAX_DURATION_NS: Final = 24 * 3_600 * NS_PER_S
"""Longest subscription (F3548-21, DSSMaxSubscriptionDuration)."""


def _query(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    subscriptions = dss.store.subscriptions_in(dss.area(request))
    return 200, {
        "subscriptions": [
            _describe_subscription(dss, subscription)
            for subscription in subscriptions
            if subscription.manager == request.claims.uss
        ]
    }


def _get(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    return 200, {"subscription": _describe_subscription(dss, _own_subscription(dss, request))}


def _put(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    body, uss, id_ = request.body, request.claims.uss, request.parameters["subscriptionid"]
    for_intents, for_constraints = (
        bool(body.get("notify_for_operational_intents")),
        bool(body.get("notify_for_constraints")),
    )
    if not (for_intents or for_constraints):
        raise RefusalError(400, "a subscription is for operational intents, constraints or both")
    version = request.parameters.get("version")
    old = dss.store.subscription(id_)
    extent = _extent(dss, turn.now, body["extents"], old)
    if old is None and version is not None:
        raise RefusalError(400, "there is no such subscription, and none of this version")
    if old is not None:
        if version is None:
            raise RefusalError(409, "the subscription exists already")
        _own_subscription(dss, request)
        for intent in map(dss.store.intent, dss.store.dependents(id_)):
            if intent is not None and not extent.covers(intent.extent):
                raise RefusalError(400, f"the subscription does not cover the intent {intent.id}, which has it")
    made = Subscription(
        id_,
        uss,
        body["uss_base_url"],
        extent,
        version=dss.renewed_uuid("version", id_, version, turn.now),
        notification_index=old.notification_index if old is not None else 0,
        is_implicit=old is not None and old.is_implicit,
        notify_for_operational_intents=for_intents,
        notify_for_constraints=for_constraints,
    )
    dss.store.put_subscription(made)
    answer: dict[str, Any] = {"subscription": _describe_subscription(dss, made)}
    if for_intents:
        answer["operational_intent_references"] = [
            dss.describe_reference(intent, uss) for intent in dss.store.intents_in(extent)
        ]
    if for_constraints:
        answer["constraint_references"] = [
            dss.describe_reference(constraint, uss) for constraint in dss.store.constraints_in(extent)
        ]
    return 200, answer


def _extent(dss: DssState, now: Time, body: Mapping[str, Any], old: Subscription | None) -> Extent:
    """What a subscription covers: from now for the longest time, unless it says when."""
    area = area_of(body, dss.epoch, "extents")
    if area.start_ns is not None and area.start_ns < now - MAX_SKEW_NS:
        raise RefusalError(400, "extents: time_start is in the past")
    now_us = now - now % NS_PER_US  # what is told is in microseconds, and has to be the same when it comes back
    start_ns = area.start_ns if area.start_ns is not None else old.extent.start_ns if old is not None else now_us
    end_ns = area.end_ns if area.end_ns is not None else old.extent.end_ns if old is not None else None
    if end_ns is None:
        end_ns = start_ns + MAX_DURATION_NS
    if end_ns < start_ns or end_ns <= now:
        raise RefusalError(400, "extents: time_end is before time_start, or over")
    if end_ns - start_ns > MAX_DURATION_NS:
        raise RefusalError(400, "extents: a subscription lasts at most 24 hours")
    return extent_of([replace(area, start_ns=start_ns, end_ns=end_ns)])


def _delete(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    subscription = _own_subscription(dss, request)
    if dss.store.dependents(subscription.id):
        raise RefusalError(400, "an operational intent has this subscription")
    dss.store.delete_subscription(subscription.id)
    return 200, {"subscription": _describe_subscription(dss, subscription)}


def _own_subscription(dss: DssState, request: IncomingRequest) -> Subscription:
    subscription = dss.store.subscription(request.parameters["subscriptionid"])
    if subscription is None:
        raise RefusalError(404, f"there is no subscription {request.parameters['subscriptionid']}")
    if subscription.manager != request.claims.uss:
        raise RefusalError(403, "the subscription belongs to another USS")
    if request.parameters.get("version", subscription.version) != subscription.version:
        raise RefusalError(409, "the version is not the current one")
    return subscription


def _describe_subscription(dss: DssState, subscription: Subscription) -> dict[str, Any]:
    return {
        "id": subscription.id,
        "version": subscription.version,
        "notification_index": subscription.notification_index,
        "time_start": moment_body(subscription.extent.start_ns, dss.epoch),
        "time_end": moment_body(subscription.extent.end_ns, dss.epoch, up=True),
        "uss_base_url": subscription.uss_base_url,
        "notify_for_operational_intents": subscription.notify_for_operational_intents,
        "notify_for_constraints": subscription.notify_for_constraints,
        "implicit_subscription": subscription.is_implicit,
        "dependent_operational_intents": dss.store.dependents(subscription.id),
    }


HANDLERS: Final[Mapping[Op, Handler]] = {
    Op.QuerySubscriptions: _query,
    Op.GetSubscription: _get,
    Op.CreateSubscription: _put,
    Op.UpdateSubscription: _put,
    Op.DeleteSubscription: _delete,
}
