"""Entities of a DSS: operational intents, constraints, subscriptions, and availabilities of USSs.

They are kept in memory, so that a request is answered without a query. A `Journal` is told of each change; a database
behind it makes them durable.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Final, Generic, Protocol, TypeVar

from uas_standards.astm.f3548.v21.api import UssAvailabilityState

from skyrange.codec.f3548.values import ConstraintReference, IntentReference
from skyrange.core.time import NS_PER_S, Time
from skyrange.utm.federated.dss.coverings import Extent
from skyrange.utm.journal import NoJournal

KEPT_NS: Final = 3_600 * NS_PER_S
"""How long an intent or a constraint is kept after its end."""


@dataclass(frozen=True, slots=True)
class StoredIntent:
    """A reference of an operational intent with what it covers."""

    reference: IntentReference
    extent: Extent

    @property
    def id(self) -> str:
        """The id of the intent."""
        return self.reference.id


@dataclass(frozen=True, slots=True)
class StoredConstraint:
    """A reference of a constraint with what it covers."""

    reference: ConstraintReference
    extent: Extent

    @property
    def id(self) -> str:
        """The id of the constraint."""
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


@dataclass(frozen=True, slots=True)
class Availability:
    """Whether a USS is available, as an arbitrator has set it."""

    id: str
    """The USS, as tokens name it."""
    state: UssAvailabilityState
    version: str


Entity = StoredIntent | StoredConstraint | Subscription | Availability


class Journal(Protocol):
    """What is told of changes of a store."""

    def put(self, entity: Entity) -> None:
        """An entity is new, or has replaced the one of its type with its id."""
        ...

    def delete(self, entity: Entity) -> None:
        """An entity is there no more."""
        ...


class _Located(Protocol):
    @property
    def id(self) -> str: ...
    @property
    def extent(self) -> Extent: ...


_E = TypeVar("_E", bound=_Located)


@dataclass(slots=True)
class _Table(Generic[_E]):
    """Entities by id, by S2 cell, and by their end."""

    entities: dict[str, _E] = field(default_factory=dict)
    cells: dict[int, dict[str, None]] = field(default_factory=dict)
    ends: list[tuple[Time, str]] = field(default_factory=list)

    def put(self, entity: _E) -> None:
        self.pop(entity.id)
        self.entities[entity.id] = entity
        for cell in entity.extent.cells:
            self.cells.setdefault(cell, {})[entity.id] = None
        heappush(self.ends, (entity.extent.end_ns, entity.id))

    def pop(self, id_: str) -> _E | None:
        entity = self.entities.pop(id_, None)
        if entity is not None:
            for cell in entity.extent.cells:
                del self.cells[cell][id_]
                if not self.cells[cell]:
                    del self.cells[cell]
        return entity

    def select(self, extent: Extent) -> Iterator[_E]:
        """Those that may intersect an extent, in the order of their ids."""
        for id_ in sorted({id_ for cell in extent.cells for id_ in self.cells.get(cell, ())}):
            entity = self.entities[id_]
            if entity.extent.may_intersect(extent):
                yield entity

    def take_ended(self, before: Time) -> Iterator[str]:
        """Ids of entities that have ended before a moment; each is told once for each version that it had."""
        while self.ends and self.ends[0][0] < before:
            _, id_ = heappop(self.ends)
            entity = self.entities.get(id_)
            if entity is not None and entity.extent.end_ns < before:
                yield id_


class DssStore:
    """The entities of a DSS. Deep-copyable if its journal is."""

    def __init__(self, journal: Journal | None = None, entities: Iterable[Entity] = ()) -> None:
        """`entities` are those that it has from the beginning."""
        self._journal: Journal = NoJournal()
        self._intents: _Table[StoredIntent] = _Table()
        self._constraints: _Table[StoredConstraint] = _Table()
        self._subscriptions: _Table[Subscription] = _Table()
        self._dependents: dict[str, dict[str, None]] = {}
        self._availabilities: dict[str, Availability] = {}
        for entity in entities:
            self._load(entity)
        if journal is not None:
            self._journal = journal

    def _load(self, entity: Entity) -> None:
        if isinstance(entity, StoredIntent):
            self.put_intent(entity)
        elif isinstance(entity, StoredConstraint):
            self.put_constraint(entity)
        elif isinstance(entity, Subscription):
            self.put_subscription(entity)
        else:
            self.put_availability(entity)

    def forget(self, now: Time) -> None:
        """Delete subscriptions that have ended, and other entities that have long ended."""
        before = now - KEPT_NS
        for id_ in self._intents.take_ended(before):
            self.delete_intent(id_)
        for id_ in self._constraints.take_ended(before):
            self.delete_constraint(id_)
        for id_ in self._subscriptions.take_ended(now):
            self.delete_subscription(id_)

    # --- operational intents -------------------------------------------------------------------------------

    def intent(self, id_: str) -> StoredIntent | None:
        """The intent with an id."""
        return self._intents.entities.get(id_)

    @property
    def intents(self) -> Iterable[StoredIntent]:
        """All of them."""
        return self._intents.entities.values()

    def put_intent(self, stored: StoredIntent) -> None:
        """Add an intent, or replace its version before."""
        self._detach(self._intents.entities.get(stored.id))
        self._intents.put(stored)
        self._dependents.setdefault(stored.reference.subscription_id, {})[stored.id] = None
        self._journal.put(stored)

    def delete_intent(self, id_: str) -> None:
        """Delete an intent, if there is one."""
        stored = self._intents.pop(id_)
        if stored is not None:
            self._detach(stored)
            self._journal.delete(stored)

    def _detach(self, stored: StoredIntent | None) -> None:
        if stored is not None:
            subscription = stored.reference.subscription_id
            del self._dependents[subscription][stored.id]
            if not self._dependents[subscription]:
                del self._dependents[subscription]

    def intents_in(self, extent: Extent) -> Iterator[StoredIntent]:
        """Those that may intersect an extent, in the order of their ids."""
        return self._intents.select(extent)

    # --- constraints ---------------------------------------------------------------------------------------

    def constraint(self, id_: str) -> StoredConstraint | None:
        """The constraint with an id."""
        return self._constraints.entities.get(id_)

    def put_constraint(self, stored: StoredConstraint) -> None:
        """Add a constraint, or replace its version before."""
        self._constraints.put(stored)
        self._journal.put(stored)

    def delete_constraint(self, id_: str) -> None:
        """Delete a constraint, if there is one."""
        stored = self._constraints.pop(id_)
        if stored is not None:
            self._journal.delete(stored)

    def constraints_in(self, extent: Extent) -> Iterator[StoredConstraint]:
        """Those that may intersect an extent, in the order of their ids."""
        return self._constraints.select(extent)

    # --- subscriptions -------------------------------------------------------------------------------------

    def subscription(self, id_: str) -> Subscription | None:
        """The subscription with an id."""
        return self._subscriptions.entities.get(id_)

    def put_subscription(self, subscription: Subscription) -> None:
        """Add a subscription, or replace its version before."""
        self._subscriptions.put(subscription)
        self._journal.put(subscription)

    def delete_subscription(self, id_: str) -> None:
        """Delete a subscription, if there is one."""
        subscription = self._subscriptions.pop(id_)
        if subscription is not None:
            self._journal.delete(subscription)

    def subscriptions_in(self, extent: Extent) -> Iterator[Subscription]:
        """Those that may intersect an extent, in the order of their ids."""
        return self._subscriptions.select(extent)

    def dependents(self, subscription: str) -> list[str]:
        """The ids of the intents that have a subscription."""
        return sorted(self._dependents.get(subscription, ()))

    # --- availabilities ------------------------------------------------------------------------------------

    def availability(self, uss: str) -> Availability:
        """Whether a USS is available; unknown, with an empty version, until it is set."""
        return self._availabilities.get(uss) or Availability(uss, UssAvailabilityState.Unknown, "")

    def put_availability(self, availability: Availability) -> None:
        """Set whether a USS is available."""
        self._availabilities[availability.id] = availability
        self._journal.put(availability)
