"""Levels of a record: which tables a run keeps of what it observes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import InputError
from skyrange.record.schema import DERIVED, TABLES

FULL: Final = "full"
STUDY: Final = "study"
SUMMARY: Final = "summary"

LEVELS: Final = (FULL, STUDY, SUMMARY)
"""From most to least."""

TELEMETRY: Final = "telemetry"
"""Stands for the tables of all MAVLink messages."""

_STUDY: Final = frozenset(
    {"truth", "sensors", "received_sensors", "decisions", "events", "labels", "alerts", "observations", "features"}
)
_SUMMARY: Final = frozenset({"decisions", "events", "alerts"})
_KEPT: Final = {FULL: frozenset({*TABLES, TELEMETRY}), STUDY: _STUDY, SUMMARY: _SUMMARY}

RECORDED: Final = {FULL: frozenset(TABLES) - DERIVED, STUDY: _STUDY, SUMMARY: _SUMMARY}
"""The tables whose rows a recorder writes; what a run at level `full` has besides is derived from them."""


def level_of(manifest: Mapping[str, Any]) -> str:
    """The level at which a run was recorded, by its manifest; those of older versions do not say it."""
    record = manifest.get("record")
    level = record.get("level") if isinstance(record, Mapping) else None
    return str(level) if level in LEVELS else FULL


def keeps(manifest: Mapping[str, Any], table: str) -> bool:
    """Whether a run with this manifest has a table of `schema.TABLES`, or "telemetry", perhaps without rows."""
    return table in _KEPT[level_of(manifest)]


def require_table(folder: Path | str, level: str, table: str) -> None:
    """Raise `InputError` if a run that was recorded at `level` into `folder` does not keep a table."""
    if table in _KEPT[level]:
        return
    enough = " or ".join(f'"{one}"' for one in reversed(LEVELS) if table in _KEPT[one])
    hint = f"It has no {table}. Run it again with --set record.level=full: the fingerprint is the same."
    raise InputError.one(str(folder), "record.level", level, f"a run recorded with [record] level = {enough}", hint)
