"""Connections to the database of a UTM service, and the migration of its tables to the newest version."""

from __future__ import annotations

from importlib.resources import as_file, files
from typing import Any

from alembic import command
from alembic.config import Config
from sqlalchemy import Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, NoSuchModuleError, SQLAlchemyError

from skyrange.core.errors import InputError


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
