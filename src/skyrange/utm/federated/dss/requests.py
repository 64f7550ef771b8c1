"""What all operations of a DSS share: its state, refusals, extents of requests, and versions of entities."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from typing import Any, Final
from uuid import UUID

from skyrange.codec.f3548.values import HIDDEN_OVN, Area, ConstraintReference, area_of
from skyrange.contracts.mailboxes import Turn
from skyrange.core.time import NS_PER_S, Epoch, Time
from skyrange.utm.contract import make_uuid
from skyrange.utm.federated.dss.coverings import Extent, extent_of
from skyrange.utm.federated.dss.store import DssStore, StoredConstraint, StoredIntent, Subscription
from skyrange.utm.federated.exchanges import IncomingRequest

MAX_SKEW_NS: Final = 300 * NS_PER_S
"""By how much the clocks of a client and the DSS may differ, as in the DSS of InterUSS (`maxClockSkew`)."""


class RefusalError(Exception):
    """A request that changes nothing."""

    def __init__(self, status: int, message: str, more: Mapping[str, Any] | None = None) -> None:
        super().__init__(message)
        self.status = status
        self.body = {"message": message, **(more or {})}


@dataclass(slots=True)
class DssState:
    """What a DSS knows. Deep-copyable."""

    name: str
    secret: bytes
    """It makes OVNs that nobody can guess."""
    epoch: Epoch
    store: DssStore = field(default_factory=DssStore)

    def make_ovn(self, *content: object) -> str:
        """The OVN of a version of an entity."""
        return blake2b(repr(content).encode(), key=self.secret, digest_size=16).hexdigest()

    def describe_reference(self, stored: StoredIntent | StoredConstraint, uss: str) -> dict[str, Any]:
        """A reference as a USS sees it: it gets an OVN of others from their USS."""
        reference: ConstraintReference = stored.reference
        reference = replace(reference, uss_availability=self.store.availability(reference.manager).state)
        if reference.manager != uss:
            reference = replace(reference, ovn=HIDDEN_OVN)
        return reference.body(self.epoch)

    def notify(self, subscriptions: Iterable[Subscription]) -> list[dict[str, Any]]:
        """Count a notification of each subscription: whom the USS that has changed an entity has to tell."""
        states_by_url: dict[str, list[dict[str, Any]]] = {}
        for subscription in subscriptions:
            counted = replace(subscription, notification_index=subscription.notification_index + 1)
            self.store.put_subscription(counted)
            state = {"subscription_id": subscription.id, "notification_index": counted.notification_index}
            states_by_url.setdefault(subscription.uss_base_url, []).append(state)
        return [{"uss_base_url": url, "subscriptions": states} for url, states in sorted(states_by_url.items())]

    def area(self, request: IncomingRequest) -> Extent:
        """The area of interest of a query."""
        area = request.body.get("area_of_interest")
        if area is None:
            raise RefusalError(400, "area_of_interest: it is needed")
        return extent_of([area_of(area, self.epoch, "area_of_interest")])

    def extent(self, now: Time, bodies: Sequence[Mapping[str, Any]], *, heights: bool) -> Extent:
        """What an entity covers; `heights` says whether its volumes need altitudes."""
        areas = [area_of(body, self.epoch, f"volume {number}") for number, body in enumerate(bodies, 1)]
        if not areas:
            raise RefusalError(400, "extents: at least one volume is needed")
        for number, area in enumerate(areas, 1):
            _check_bounds(number, area, heights=heights)
        extent = extent_of(areas)
        if extent.end_ns <= now:
            raise RefusalError(400, "extents: all are over")
        return extent

    def renewed_uuid(self, *what: object) -> str:
        """A UUID that no other of these has, for `what` at one moment."""
        return make_uuid(f"{self.name} {self.make_ovn(*what)}")


def _check_bounds(number: int, area: Area, *, heights: bool) -> None:
    if area.start_ns is None or area.end_ns is None:
        raise RefusalError(400, f"volume {number}: it needs time_start and time_end")
    if heights and (area.lower_m is None or area.upper_m is None):
        raise RefusalError(400, f"volume {number}: it needs altitude_lower and altitude_upper")


def check_version(kind: str, uss: str, old: ConstraintReference | None, ovn: str | None, missing: int) -> None:
    """Refuse a change that is not one of the current version by its manager; of an unknown entity with `missing`."""
    if old is None:
        if ovn is not None:
            raise RefusalError(missing, f"there is no such {kind}, and none of version {ovn}")
    elif old.manager != uss:
        raise RefusalError(403, f"the {kind} is managed by another USS")
    elif old.ovn != ovn:
        raise RefusalError(409, "the OVN is not that of the current version")


def requested_ovn(now: Time, epoch: Epoch, id_: str, suffix: str) -> str:
    """The OVN that a USS asks for, by the optional extension of InterUSS: the id and a UUID of version 7 of now."""
    try:
        uuid = UUID(suffix)
    except ValueError:
        raise RefusalError(400, f"requested_ovn_suffix: {suffix[:64]!r} is no UUID") from None
    if uuid.version != 7:
        raise RefusalError(400, f"requested_ovn_suffix: a UUID of version 7 is needed, this has {uuid.version}")
    made_ns = (uuid.int >> 80) * 1_000_000 - epoch.unix_ns  # RFC 9562, 5.7: milliseconds since 1970 in 48 bits
    if abs(now - made_ns) > MAX_SKEW_NS:
        raise RefusalError(400, "requested_ovn_suffix: its time is more than 5 minutes from now")
    return f"{id_}_{uuid}"


Handler = Callable[[DssState, Turn, IncomingRequest], tuple[int, Any]]
"""`handle(state, now, asked, out)`: status and body of the response. Raises `RefusalError`, `DecodeError` and
`AreaError`."""
