"""Placement of a finished run's tables in its folder, and its operator files if they are wanted.

The files are complete beside the spool before the first is placed, and stay there until the manifest is replaced. Until
then readers use the spool's folder.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.record.folder import describe_files
from skyrange.record.read.tables import Tables
from skyrange.record.read.telemetry import FOLDER
from skyrange.record.schema import RECORDED, TABLES, level_of
from skyrange.record.spool import OPEN, SPOOL, part_path, shard_folder, spool_files, write_error
from skyrange.record.write.files.operator_files import OPERATORS, write_operator_files
from skyrange.record.write.files.part_writer import PartWriter


class Finished(NamedTuple):
    """Entries of the manifest of a finished run."""

    counts: dict[str, int]
    """Rows by table."""
    messages: dict[str, int] | None
    """Rows of telemetry by message; None if no frames were kept."""
    files: dict[str, dict[str, Any]]


class Shard(NamedTuple):
    """What a process has written of a run: all its parts are closed, in the folder of its shard."""

    number: int
    messages: dict[str, int] | None
    """Rows of telemetry by message; None if no frames were kept."""
    derived: dict[str, int]
    """Rows of the tables that were derived in a file each."""
    described: dict[str, dict[str, Any]]
    """Size and hash of parts, by name."""


def finish_shard(writer: PartWriter, number: int) -> Shard:
    """Write the rest of a shard. Raises `ComponentError` if writing fails."""
    messages, derived = writer.finish()
    return Shard(number, messages, derived, {path.name: known for path, known in writer.described.items()})


def finalise(
    folder: Path, manifest: Mapping[str, Any], shards: Sequence[Shard], described: Mapping[str, dict[str, Any]]
) -> Finished:
    """Place all tables of the run in `folder`, which `shards` are of, and with `csv` in the manifest's `record` write
    CSV files and tlogs. `described` has the size and hash of other files that are known.

    Raises `ComponentError` if writing fails; the record then remains in its spool and in closed parts.
    """
    folder = folder.absolute()
    tables = Tables(folder, spooled=True, trusted=True)
    counts: dict[str, int] = {}
    known = dict(described)
    spool = folder / SPOOL
    try:
        if manifest["record"]["csv"]:
            made = spool / f"{OPERATORS}{OPEN}"
            made.mkdir()
            write_operator_files(made, tables, manifest)
            _place_folder(made, folder / OPERATORS)
        recorded = RECORDED[level_of(manifest)] - {"features"}  # whose parts are merged
        for name in TABLES:
            parts = _list_parts(folder, name, shards) if name in recorded else []
            if parts:
                counts[name] = tables.rows(name)
            for shard, number, path in parts:
                target = part_path(folder / f"{name}.parquet", number, len(parts), shard.number)
                _place(path, target)
                if path.name in shard.described:
                    known[target.relative_to(folder).as_posix()] = shard.described[path.name]
        for name in dict.fromkeys(name for shard in shards for name in shard.derived):
            having = [shard for shard in shards if name in shard.derived]
            for shard in having:
                counts[name] = counts.get(name, 0) + shard.derived[name]
                target = part_path(folder / f"{name}.parquet", 0, len(having), shard.number)
                _place(shard_folder(folder, shard.number) / SPOOL / f"{name}.parquet{OPEN}", target)
        messages = _place_telemetry(folder, shards) if "frames" in recorded else None
    except (OSError, pa.ArrowException) as error:
        raise write_error(folder, error) from error
    return Finished(counts, messages, describe_files(folder, known))


def _list_parts(folder: Path, table: str, shards: Sequence[Shard]) -> list[tuple[Shard, int, Path]]:
    """The closed parts of a table with their shards and numbers; without empty ones where another has rows."""
    parts = [
        (shard, number, file.path)
        for shard in shards
        for number, file in enumerate(spool_files(shard_folder(folder, shard.number), table))
    ]
    if len(shards) == 1:
        return parts
    return [part for part in parts if pq.read_metadata(part[2]).num_rows] or parts[:1]


def _place_telemetry(folder: Path, shards: Sequence[Shard]) -> dict[str, int]:
    """Place the tables of messages; returns the rows of each."""
    counts: dict[str, int] = {}
    having: dict[str, list[Shard]] = {}
    for shard in shards:
        for message, rows in (shard.messages or {}).items():
            counts[message] = counts.get(message, 0) + rows
            having.setdefault(message, []).append(shard)
    for message, parts in having.items():
        name = f"{message}.parquet"
        (folder / FOLDER).mkdir(exist_ok=True)
        for shard in parts:
            made = shard_folder(folder, shard.number) / SPOOL / f"{FOLDER}{OPEN}" / name
            _place(made, part_path(folder / FOLDER / name, 0, len(parts), shard.number))
    return dict(sorted(counts.items()))


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
