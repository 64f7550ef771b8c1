"""Databases of UTM services: what an agent has stored is there after a restart, to the last committed step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import Engine, create_engine
from sqlalchemy.pool import StaticPool
from uas_standards.astm.f3548.v21.api import OperationalIntentState, UssAvailabilityState
from uas_standards.astm.f3548.v21.api import OperationID as Op

from skyrange.codec.f3548.frames import UssRequest, decode
from skyrange.codec.f3548.operations import path_of
from skyrange.codec.f3548.values import ConstraintReference, IntentReference
from skyrange.contracts.mailboxes import Inbox
from skyrange.core.errors import InputError
from skyrange.core.ids import Port
from skyrange.runtime.utm.database.journal import Changes, DssJournal, UssJournal
from skyrange.runtime.utm.database.tables import METADATA, migrate, open_engine
from skyrange.testing.checks.approval_policies import EPOCH, box
from skyrange.utm.authority import AuthorityParams
from skyrange.utm.contract import OperationalIntent, intent_id, make_uuid
from skyrange.utm.federated.dss.coverings import Extent
from skyrange.utm.federated.dss.store import (
    Availability,
    DssStore,
    Entity,
    StoredConstraint,
    StoredIntent,
    Subscription,
)
from skyrange.utm.federated.exchanges import KnownPeers, Peer
from skyrange.utm.federated.tokens import TokenChecker, TokenStore, public_of
from skyrange.utm.federated.uss.service import Uss
from skyrange.utm.federated.uss.shared_intents import OwnIntent
from skyrange.utm.intent_states import IntentState

SECRET = bytes(range(32))


def memory() -> Engine:
    """A database of SQLite that lives as long as its engine."""
    engine = create_engine("sqlite://", poolclass=StaticPool)
    migrate(engine)
    return engine


def test_migrations_lead_to_the_tables_of_the_code() -> None:
    with memory().connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), METADATA) == []


def test_a_database_is_migrated_once_and_opened_again(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'a%20b.db'}"
    for _ in range(2):
        open_engine(url, "north").dispose()


@pytest.mark.parametrize(
    "url", ["nonsense", "sqlite:////no/such/folder/x.db", "nosuch://x:secret@y", "postgresql://x:secret@127.0.0.1:1/x"]
)
def test_a_database_that_cannot_be_opened_is_an_error_that_names_it(url: str) -> None:
    with pytest.raises(InputError, match="north: database") as caught:
        open_engine(url, "north")
    assert "secret" not in str(caught.value)


NAMES = st.sampled_from([make_uuid(name) for name in "abc"])
TEXT = st.text(max_size=8)
NS = st.integers(0, 2**62)
METRES = st.floats(-8_000, 100_000)
EXTENTS = st.builds(Extent, st.frozensets(st.integers(0, 2**64 - 1), min_size=1, max_size=4), METRES, METRES, NS, NS)
COMMON = {"id": NAMES, "manager": TEXT, "version": st.integers(1, 9), "ovn": TEXT, "uss_base_url": TEXT}
TIMES = {"start_ns": NS, "end_ns": NS}
ENTITIES = st.one_of(
    st.builds(
        StoredIntent,
        st.builds(
            IntentReference, **COMMON, **TIMES, state=st.sampled_from(OperationalIntentState), subscription_id=NAMES
        ),
        EXTENTS,
    ),
    st.builds(StoredConstraint, st.builds(ConstraintReference, **COMMON, **TIMES), EXTENTS),
    st.builds(Subscription, NAMES, TEXT, TEXT, EXTENTS, TEXT, st.integers(0, 9), st.booleans(), st.booleans()),
    st.builds(Availability, TEXT, st.sampled_from(UssAvailabilityState), TEXT),
)


def fitting(entity: Entity) -> Entity:
    """The entity with the times of its extent, as a DSS stores it."""
    if isinstance(entity, (StoredIntent, StoredConstraint)):
        reference = type(entity.reference)(
            **{
                **{name: getattr(entity.reference, name) for name in entity.reference.__dataclass_fields__},
                "start_ns": entity.extent.start_ns,
                "end_ns": entity.extent.end_ns,
            }
        )
        return type(entity)(reference, entity.extent)  # type: ignore[arg-type]
    return entity


def content(store: DssStore) -> list[Entity]:
    everywhere: list[Entity] = [*store.intents, *store._constraints.entities.values()]
    everywhere += [*store._subscriptions.entities.values(), *store._availabilities.values()]
    return sorted(everywhere, key=repr)


@given(st.lists(st.tuples(ENTITIES.map(fitting), st.sampled_from(["put", "put", "delete", "commit"])), max_size=20))
def test_a_dss_has_after_a_restart_what_it_had_at_its_last_commit(acts: list[tuple[Entity, str]]) -> None:
    engine = memory()
    changes = Changes(engine)
    store = DssStore(DssJournal(changes))
    committed: list[Entity] = []
    for entity, act in acts:
        if act == "commit":
            changes.commit()
            committed = content(store)
        elif isinstance(entity, StoredIntent):
            store.put_intent(entity) if act == "put" else store.delete_intent(entity.id)
        elif isinstance(entity, StoredConstraint):
            store.put_constraint(entity) if act == "put" else store.delete_constraint(entity.id)
        elif isinstance(entity, Subscription):
            store.put_subscription(entity) if act == "put" else store.delete_subscription(entity.id)
        else:
            store.put_availability(entity)
    again = DssStore(None, DssJournal(Changes(engine)).entities())
    assert content(again) == committed
    engine.dispose()


OWN = st.builds(
    OwnIntent,
    st.builds(
        OperationalIntent,
        NAMES,
        TEXT,
        TEXT,
        st.lists(
            st.builds(box, st.floats(-80, 80), st.floats(-170, 170), start_s=st.floats(0, 1e6)), min_size=1, max_size=3
        ).map(tuple),
        st.integers(0, 9),
        st.sampled_from(IntentState),
    ),
    st.builds(IntentReference, **COMMON, **TIMES, state=st.sampled_from(OperationalIntentState), subscription_id=NAMES),
)


@given(st.lists(st.tuples(OWN, st.booleans()), max_size=6))
def test_a_uss_has_after_a_restart_the_intents_that_it_managed(acts: list[tuple[OwnIntent, bool]]) -> None:
    engine = memory()
    changes = Changes(engine)
    journal, kept = UssJournal(changes), {}
    for own, stays in acts:
        own = own._replace(reference=type(own.reference)(**{**fields(own.reference), "id": own.intent.id}))
        kept[own.intent.id] = own
        journal.put(own)
        if not stays:
            journal.delete(own.intent.id)
            del kept[own.intent.id]
    changes.commit()
    assert {one.intent.id: one for one in UssJournal(Changes(engine)).intents()} == kept
    engine.dispose()


def fields(reference: IntentReference) -> dict[str, Any]:
    return {name: getattr(reference, name) for name in reference.__dataclass_fields__}


def test_an_end_of_which_the_dss_has_not_heard_is_asked_for_after_a_restart() -> None:
    ended = OperationalIntent(intent_id("blue/a"), "blue", "blue/a", (), state=IntentState.ENDED)
    reference = IntentReference(
        id=ended.id,
        manager="north",
        version=1,
        ovn="of-the-version-1",
        start_ns=0,
        end_ns=1,
        uss_base_url="https://north",
        state=OperationalIntentState.Accepted,
    )
    uss = Uss(
        "north",
        "north",
        operators=[("blue", Port("approval", "approval:blue"))],
        dss=Peer("dss", Port("approval.north", "uss:dss")),
        directory=KnownPeers({}),
        base_url="https://north",
        tokens=TokenStore("north", SECRET, EPOCH),
        checker=TokenChecker(frozenset({"north"}), (public_of(SECRET),), EPOCH),
        limits=AuthorityParams().limits,
        epoch=EPOCH,
        earlier_intents=[OwnIntent(ended, reference)],
    )
    (departure,) = uss.step(0, Inbox()).departures
    request = decode(departure.payload)
    assert isinstance(request, UssRequest)
    path = path_of(Op.DeleteOperationalIntentReference, entityid=ended.id, ovn=reference.ovn)
    assert (request.method, request.path) == path
