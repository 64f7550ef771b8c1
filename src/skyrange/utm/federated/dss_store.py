"""Entities of a DSS in memory: references of operational intents, subscriptions and availabilities of USSs.

Deep-copyable. Whatever replaces it has the same methods.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from uas_standards.astm.f3548.v21.api import UssAvailabilityState

from skyrange.codec.f3548.values import IntentReference
from skyrange.utm.federated.coverings import Extent


class _Located(Protocol):
    @property
    def id(self) -> str: ...
    @property
    def extent(self) -> Extent: ...


_E = TypeVar("_E", bound=_Located)


@dataclass(frozen=True, slots=True)
class StoredIntent:
    """A reference with what it covers."""

    reference: IntentReference
    extent: Extent

    @property
    def id(self) -> str:
        """The id of the intent."""
        return self.reference.id


@dataclass(frozen=True, slots=True)
class Subscription:
    """Who wants to be told of changes in an area."""

    id: str
    manager: str
    uss_base_url: str
    extent: Extent
    version: str
    notification_index: int = 0
    is_implicit: bool = False
    """Whether it was made with an intent, and ends with the last intent that has it."""
    notify_for_operational_intents: bool = True
    notify_for_constraints: bool = False


@dataclass(slots=True)
class _Index:
    """Ids by S2 cell."""

    cells: dict[int, dict[str, None]] = field(default_factory=dict)

    def add(self, id_: str, cells: Iterable[int]) -> None:
        for cell in cells:
            self.cells.setdefault(cell, {})[id_] = None

    def remove(self, id_: str, cells: Iterable[int]) -> None:
        for cell in cells:
            del self.cells[cell][id_]
            if not self.cells[cell]:
                del self.cells[cell]

    def near(self, cells: Iterable[int]) -> list[str]:
        return sorted({id_ for cell in cells for id_ in self.cells.get(cell, ())})


class DssStore:
    """The entities of a DSS."""

    def __init__(self) -> None:
        self._intents: dict[str, StoredIntent] = {}
        self._subscriptions: dict[str, Subscription] = {}
        self._intents_by_cell = _Index()
        self._subscriptions_by_cell = _Index()
        self._dependents: dict[str, dict[str, None]] = {}
        self._availability: dict[str, tuple[UssAvailabilityState, str]] = {}

    # --- operational intents -------------------------------------------------------------------------------

    def intent(self, id_: str) -> StoredIntent | None:
        """The intent with an id."""
        return self._intents.get(id_)

    def put_intent(self, stored: StoredIntent) -> None:
        """Add an intent, or replace its version before."""
        self.delete_intent(stored.id)
        self._intents[stored.id] = stored
        self._intents_by_cell.add(stored.id, stored.extent.cells)
        self._dependents.setdefault(stored.reference.subscription_id, {})[stored.id] = None

    def delete_intent(self, id_: str) -> None:
        """Remove an intent, if there is one."""
        stored = self._intents.pop(id_, None)
        if stored is not None:
            self._intents_by_cell.remove(id_, stored.extent.cells)
            dependents = self._dependents[stored.reference.subscription_id]
            del dependents[id_]
            if not dependents:
                del self._dependents[stored.reference.subscription_id]

    def intents_in(self, extent: Extent) -> Iterator[StoredIntent]:
        """Those that may intersect an extent, in the order of their ids."""
        return _select(self._intents, self._intents_by_cell, extent)

    # --- subscriptions -------------------------------------------------------------------------------------

    def subscription(self, id_: str) -> Subscription | None:
        """The subscription with an id."""
        return self._subscriptions.get(id_)

    def put_subscription(self, subscription: Subscription) -> None:
        """Add a subscription, or replace its version before."""
        self.delete_subscription(subscription.id)
        self._subscriptions[subscription.id] = subscription
        self._subscriptions_by_cell.add(subscription.id, subscription.extent.cells)

    def delete_subscription(self, id_: str) -> None:
        """Remove a subscription, if there is one."""
        subscription = self._subscriptions.pop(id_, None)
        if subscription is not None:
            self._subscriptions_by_cell.remove(id_, subscription.extent.cells)

    def subscriptions_in(self, extent: Extent) -> Iterator[Subscription]:
        """Those that may intersect an extent, in the order of their ids."""
        return _select(self._subscriptions, self._subscriptions_by_cell, extent)

    def dependents(self, subscription: str) -> list[str]:
        """The ids of the intents that have a subscription."""
        return sorted(self._dependents.get(subscription, ()))

    # --- availability --------------------------------------------------------------------------------------

    def availability(self, uss: str) -> tuple[UssAvailabilityState, str]:
        """Whether a USS is available, and the version of that; unknown and none until it is set."""
        return self._availability.get(uss, (UssAvailabilityState.Unknown, ""))

    def set_availability(self, uss: str, state: UssAvailabilityState, version: str) -> None:
        """Set whether a USS is available."""
        self._availability[uss] = state, version


def _select(entities: dict[str, _E], index: _Index, extent: Extent) -> Iterator[_E]:
    for id_ in index.near(extent.cells):
        entity = entities[id_]
        if entity.extent.may_intersect(extent):
            yield entity
