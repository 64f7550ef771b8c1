"""Placement of a finished run's tables in its folder, and its operator files if they are wanted.

The files are complete beside the spool before the first is placed, and stay there until the manifest is replaced. Until
then readers use the spool's folder.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from skyrange.record.file_hashes import describe_files
from skyrange.record.part_files import OPEN, part_path, spool_files
from skyrange.record.read.tables import Tables
from skyrange.record.read.telemetry import FOLDER
from skyrange.record.schema import DERIVED, TABLES
from skyrange.record.spool import SPOOL, write_error
from skyrange.record.write.operator_files import OPERATORS, write_operator_files
from skyrange.record.write.part_writer import PartWriter


class Finished(NamedTuple):
    """Entries of the manifest of a finished run."""

    counts: dict[str, int]
    """Rows by table."""
    messages: dict[str, int]
    """Rows of telemetry by message."""
    files: dict[str, dict[str, Any]]


def finalise(folder: Path, manifest: Mapping[str, Any], writer: PartWriter) -> Finished:
    """Place all tables of the run in `folder`, which `writer` has written, and with `csv` in the manifest's `record`
    write CSV files and tlogs.

    Raises `ComponentError` if writing fails; the record then remains in its spool and in closed parts.
    """
    messages, observed = writer.finish()
    folder = folder.absolute()
    tables = Tables(folder, spooled=True, trusted=True)
    counts: dict[str, int] = {}
    known: dict[str, dict[str, Any]] = {}
    spool = folder / SPOOL
    try:
        if (manifest.get("record") or {}).get("csv"):
            made = spool / f"{OPERATORS}{OPEN}"
            made.mkdir()
            write_operator_files(made, tables, manifest)
            _place_folder(made, folder / OPERATORS)
        for name in TABLES:
            parts = [file.path for file in spool_files(folder, name)] if name not in DERIVED else []
            if parts:
                counts[name] = tables.rows(name)
            for number, path in enumerate(parts):
                target = part_path(folder / f"{name}.parquet", number, len(parts))
                _place(path, target)
                if path in writer.described:
                    known[target.relative_to(folder).as_posix()] = writer.described[path]
        if observed:
            counts["observations"] = observed
            _place(spool / f"observations.parquet{OPEN}", folder / "observations.parquet")
        if messages:
            _place_folder(spool / f"{FOLDER}{OPEN}", folder / FOLDER)
    except (OSError, pa.ArrowException) as error:
        raise write_error(folder, error) from error
    return Finished(counts, dict(sorted(messages.items())), describe_files(folder, known))


def _place_folder(folder: Path, target: Path) -> None:
    for path in folder.iterdir():
        _place(path, target / path.name)


def _place(path: Path, target: Path) -> None:
    """Give a file a second name, or copy it where the file system has no such names."""
    target.parent.mkdir(exist_ok=True)
    target.unlink(missing_ok=True)
    try:
        os.link(path, target)
    except OSError:
        shutil.copyfile(path, target)
