"""Tables of the databases of UTM services, as the newest migration leaves them, and connections to them.

Times are nanoseconds since 1970 UTC, heights metres above the ellipsoid; cells and volumes are JSON.
"""

from __future__ import annotations

from importlib.resources import as_file, files
from typing import Any, Final

from alembic import command
from alembic.config import Config
from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Engine,
    Float,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    create_engine,
    event,
    make_url,
)
from sqlalchemy.exc import ArgumentError, NoSuchModuleError, SQLAlchemyError

from skyrange.core.errors import InputError

METADATA: Final = MetaData()
_ID = 64
_NAME = 256
_URL = 8_192


def _extent() -> list[Column[object]]:
    return [
        Column("cells", Text, nullable=False),
        Column("lower_m", Float, nullable=False),
        Column("upper_m", Float, nullable=False),
        Column("start_ns", BigInteger, nullable=False),
        Column("end_ns", BigInteger, nullable=False),
    ]


def _reference() -> list[Column[object]]:
    return [
        Column("id", String(_ID), primary_key=True),
        Column("manager", String(_NAME), nullable=False),
        Column("version", Integer, nullable=False),
        Column("ovn", String(_NAME), nullable=False),
        Column("uss_base_url", String(_URL), nullable=False),
    ]


DSS_INTENTS: Final = Table(
    "dss_intents",
    METADATA,
    *_reference(),
    Column("state", String(16), nullable=False),
    Column("subscription_id", String(_ID), nullable=False),
    *_extent(),
)
DSS_CONSTRAINTS: Final = Table("dss_constraints", METADATA, *_reference(), *_extent())
DSS_SUBSCRIPTIONS: Final = Table(
    "dss_subscriptions",
    METADATA,
    Column("id", String(_ID), primary_key=True),
    Column("manager", String(_NAME), nullable=False),
    Column("uss_base_url", String(_URL), nullable=False),
    Column("version", String(_NAME), nullable=False),
    Column("notification_index", Integer, nullable=False),
    Column("is_implicit", Boolean, nullable=False),
    Column("notify_for_operational_intents", Boolean, nullable=False),
    Column("notify_for_constraints", Boolean, nullable=False),
    *_extent(),
)
DSS_AVAILABILITIES: Final = Table(
    "dss_availabilities",
    METADATA,
    Column("id", String(_NAME), primary_key=True),
    Column("state", String(16), nullable=False),
    Column("version", String(_NAME), nullable=False),
)


def _claim() -> list[Column[object]]:
    return [
        Column("operator", String(_NAME), nullable=False),
        Column("vehicle", String(_NAME), nullable=False),
        Column("priority", Integer, nullable=False),
        Column("state", String(16), nullable=False),
        Column("volumes", Text, nullable=False),
    ]


AUTHORITY_INTENTS: Final = Table("authority_intents", METADATA, Column("id", String(_ID), primary_key=True), *_claim())
"""Intents that an authority has accepted."""
USS_INTENTS: Final = Table(
    "uss_intents",
    METADATA,
    *_reference(),
    Column("start_ns", BigInteger, nullable=False),
    Column("end_ns", BigInteger, nullable=False),
    Column("subscription_id", String(_ID), nullable=False),
    Column("reference_state", String(16), nullable=False),
    *_claim(),
)
"""Intents that a USS manages: the reference that the DSS has, and what its operator claims. One that has ended, perhaps
not yet at the DSS, has the state Ended."""


def open_engine(url: str, who: str) -> Engine:
    """An engine for the database at a URL, with its tables up to date. Raises `InputError`."""
    shown = repr(url)
    try:
        shown = repr(make_url(url).render_as_string(hide_password=True))
        engine = create_engine(url)
        if engine.dialect.name == "sqlite":
            event.listen(engine, "connect", _make_durable)
        migrate(engine)
    except ImportError as error:
        raise InputError.one(
            who, "database", shown, "a URL of a database whose driver is installed", str(error)
        ) from error
    except (ArgumentError, NoSuchModuleError) as error:
        raise InputError.one(who, "database", shown, "a URL such as sqlite:///north.db", str(error)) from error
    except SQLAlchemyError as error:
        reason = str(getattr(error, "orig", None) or error)
        raise InputError.one(who, "database", shown, "a database that can be opened", reason) from error
    return engine


def migrate(engine: Engine) -> None:
    """Bring the tables to the newest version."""
    with as_file(files("skyrange.runtime.utm.database") / "migrations") as folder, engine.begin() as connection:
        config = Config()
        config.set_main_option("script_location", str(folder).replace("%", "%%"))
        config.attributes["connection"] = connection
        command.upgrade(config, "head")


def _make_durable(connection: Any, record: Any) -> None:
    """A commit of SQLite that has returned outlasts a power cut; readers do not block it."""
    cursor = connection.cursor()
    cursor.execute("PRAGMA journal_mode=WAL")
    cursor.execute("PRAGMA synchronous=FULL")
    cursor.close()
