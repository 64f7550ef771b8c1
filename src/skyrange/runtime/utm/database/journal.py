"""Journals of UTM services: changes are collected during a step of the agent, and committed at its end."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, Final

from sqlalchemy import Engine, Table, bindparam, select
from uas_standards.astm.f3548.v21.api import OperationalIntentState, UssAvailabilityState

from skyrange.codec.f3548.values import ConstraintReference, IntentReference
from skyrange.core.volumes import Volume4D
from skyrange.runtime.utm.database.tables import (
    AUTHORITY_INTENTS,
    DSS_AVAILABILITIES,
    DSS_CONSTRAINTS,
    DSS_INTENTS,
    DSS_SUBSCRIPTIONS,
    USS_INTENTS,
)
from skyrange.utm.contract import OperationalIntent
from skyrange.utm.federated.dss.coverings import Extent
from skyrange.utm.federated.dss.store import Availability, Entity, StoredConstraint, StoredIntent, Subscription
from skyrange.utm.federated.uss.shared_intents import OwnIntent
from skyrange.utm.intent_states import IntentState

Row = dict[str, Any]


class Changes:
    """Rows of a database that are to be replaced or deleted in the next transaction."""

    def __init__(self, engine: Engine) -> None:
        """`engine` is that of the database."""
        self._engine = engine
        self._rows: dict[Table, dict[str, Row | None]] = {}

    def put(self, table: Table, row: Row) -> None:
        """A row is new, or replaces the one with its id."""
        self._rows.setdefault(table, {})[row["id"]] = row

    def delete(self, table: Table, id_: str) -> None:
        """The row with an id is there no more."""
        self._rows.setdefault(table, {})[id_] = None

    def commit(self) -> None:
        """Write all changes in one transaction, if there are any; it is durable when this returns."""
        if not self._rows:
            return
        changes, self._rows = self._rows, {}
        with self._engine.begin() as connection:
            for table, rows in changes.items():
                connection.execute(table.delete().where(table.c.id == bindparam("old")), [{"old": id_} for id_ in rows])
                added = [row for row in rows.values() if row is not None]
                if added:
                    connection.execute(table.insert(), added)

    def close(self) -> None:
        """Close the database; SQLite then moves what its write-ahead log has into the file."""
        self._engine.dispose()

    def read(self, table: Table) -> Iterator[Mapping[str, Any]]:
        """All rows of a table."""
        with self._engine.connect() as connection:
            for row in connection.execute(select(table)).mappings():
                yield {str(name): value for name, value in row.items()}


class DssJournal:
    """The journal of a DSS."""

    def __init__(self, changes: Changes) -> None:
        """Its entities become rows of `changes`."""
        self._changes = changes

    def put(self, entity: Entity) -> None:
        """An entity is new, or has replaced the one of its type with its id."""
        if isinstance(entity, StoredIntent):
            more = {"state": entity.reference.state.value, "subscription_id": entity.reference.subscription_id}
            row = _reference_row(entity.reference) | more | _extent_row(entity.extent)
        elif isinstance(entity, StoredConstraint):
            row = _reference_row(entity.reference) | _extent_row(entity.extent)
        elif isinstance(entity, Subscription):
            row = {name: getattr(entity, name) for name in _SUBSCRIPTION} | _extent_row(entity.extent)
        else:
            row = {"id": entity.id, "state": entity.state.value, "version": entity.version}
        self._changes.put(_TABLES[type(entity)], row)

    def delete(self, entity: Entity) -> None:
        """An entity is there no more."""
        self._changes.delete(_TABLES[type(entity)], entity.id)

    def entities(self) -> Iterator[Entity]:
        """All that the database has."""
        for row in self._changes.read(DSS_SUBSCRIPTIONS):
            yield Subscription(**{name: row[name] for name in _SUBSCRIPTION}, extent=_extent_of(row))
        for row in self._changes.read(DSS_INTENTS):
            state = OperationalIntentState(row["state"])
            reference = IntentReference(**_reference_fields(row), state=state, subscription_id=row["subscription_id"])
            yield StoredIntent(reference, _extent_of(row))
        for row in self._changes.read(DSS_CONSTRAINTS):
            yield StoredConstraint(ConstraintReference(**_reference_fields(row)), _extent_of(row))
        for row in self._changes.read(DSS_AVAILABILITIES):
            yield Availability(row["id"], UssAvailabilityState(row["state"]), row["version"])


class UssJournal:
    """The journal of a USS."""

    def __init__(self, changes: Changes) -> None:
        """Its intents become rows of `changes`."""
        self._changes = changes

    def put(self, own_intent: OwnIntent) -> None:
        """An intent that the USS manages is new, or has another version."""
        intent, reference = own_intent
        row = _reference_row(reference) | {
            "start_ns": reference.start_ns,
            "end_ns": reference.end_ns,
            "subscription_id": reference.subscription_id,
            "reference_state": reference.state.value,
        }
        row |= _intent_row(intent)
        self._changes.put(USS_INTENTS, row)

    def delete(self, id_: str) -> None:
        """An intent has ended."""
        self._changes.delete(USS_INTENTS, id_)

    def intents(self) -> Iterator[OwnIntent]:
        """All that the database has."""
        for row in self._changes.read(USS_INTENTS):
            reference = IntentReference(
                **_reference_fields(row),
                state=OperationalIntentState(row["reference_state"]),
                subscription_id=row["subscription_id"],
            )
            yield OwnIntent(_intent_of(row), reference)


class AuthorityJournal:
    """The journal of an approval authority."""

    def __init__(self, changes: Changes) -> None:
        """Its intents become rows of `changes`."""
        self._changes = changes

    def put(self, intent: OperationalIntent) -> None:
        """An intent was accepted, or has another version or state."""
        self._changes.put(AUTHORITY_INTENTS, {"id": intent.id} | _intent_row(intent))

    def delete(self, id_: str) -> None:
        """An intent is accepted no more."""
        self._changes.delete(AUTHORITY_INTENTS, id_)

    def intents(self) -> Iterator[OperationalIntent]:
        """All that the database has."""
        return map(_intent_of, self._changes.read(AUTHORITY_INTENTS))


_TABLES: Final[Mapping[type[Entity], Table]] = {
    StoredIntent: DSS_INTENTS,
    StoredConstraint: DSS_CONSTRAINTS,
    Subscription: DSS_SUBSCRIPTIONS,
    Availability: DSS_AVAILABILITIES,
}
_SUBSCRIPTION: Final = (
    "id",
    "manager",
    "uss_base_url",
    "version",
    "notification_index",
    "is_implicit",
    "notify_for_operational_intents",
    "notify_for_constraints",
)


def _intent_row(intent: OperationalIntent) -> Row:
    return {
        "operator": intent.operator,
        "vehicle": intent.vehicle,
        "priority": intent.priority,
        "state": intent.state.value,
        "volumes": json.dumps([_volume_row(volume) for volume in intent.volumes]),
    }


def _intent_of(row: Mapping[str, Any]) -> OperationalIntent:
    volumes = tuple(_volume_of(volume) for volume in json.loads(row["volumes"]))
    state = IntentState(row["state"])
    return OperationalIntent(row["id"], row["operator"], row["vehicle"], volumes, row["priority"], state)


def _reference_row(reference: ConstraintReference) -> Row:
    return {
        "id": reference.id,
        "manager": reference.manager,
        "version": reference.version,
        "ovn": reference.ovn,
        "uss_base_url": reference.uss_base_url,
    }


def _reference_fields(row: Mapping[str, Any]) -> Row:
    return {name: row[name] for name in ("id", "manager", "version", "ovn", "uss_base_url", "start_ns", "end_ns")}


def _extent_row(extent: Extent) -> Row:
    return {
        "cells": json.dumps(sorted(extent.cells)),
        "lower_m": extent.lower_m,
        "upper_m": extent.upper_m,
        "start_ns": extent.start_ns,
        "end_ns": extent.end_ns,
    }


def _extent_of(row: Mapping[str, Any]) -> Extent:
    cells = frozenset(json.loads(row["cells"]))
    return Extent(cells, row["lower_m"], row["upper_m"], row["start_ns"], row["end_ns"])


def _volume_row(volume: Volume4D) -> list[Any]:
    return [volume.outline, volume.lower_m, volume.upper_m, volume.start_ns, volume.end_ns]


def _volume_of(row: list[Any]) -> Volume4D:
    outline, lower_m, upper_m, start_ns, end_ns = row
    return Volume4D(tuple((lat, lng) for lat, lng in outline), lower_m, upper_m, start_ns, end_ns)
