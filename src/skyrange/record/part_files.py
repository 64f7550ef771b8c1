"""Names of the files that hold a table: one Parquet file, a folder of part files, or closed parts and an open spool."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, NamedTuple

from skyrange.record.spool import SPOOL

OPEN: Final = ".new"
"""Suffix of a Parquet file that is still being written, in the spool's folder."""

_NUMBERED: Final = re.compile(r"-(\d{4,})\.(arrows|parquet)$")
_SHARD: Final = "core-{}"
"""Folder, in the spool's folder, of the shard that a process other than the first records, and prefix of its parts."""


def table_files(path: Path) -> list[Path]:
    """The Parquet files of the table `path`, such as `frames.parquet`: the file itself, or if it is a folder, its parts
    in order; none if it does not exist.
    """
    return [part for shard in table_shards(path) for part in shard]


def table_shards(path: Path) -> list[list[Path]]:
    """The files of a table, as `table_files` has them, for each process that recorded some."""
    if not path.is_dir():
        return [[path]] if path.exists() else []
    prefixes = {part.name.rpartition("-")[0] for part in path.glob("*.parquet")}
    found = (_numbered(path, f"{prefix}-*.parquet") for prefix in sorted(prefixes, key=_shard_number))
    return [[part for _, part in sorted(parts.items())] for parts in found if parts]


def part_path(path: Path, number: int, count: int, shard: int = 0) -> Path:
    """Where part `number` of a shard of the table `path` belongs; a table of `count` 1 part is one file."""
    prefix = _SHARD.format(shard) if shard else "part"
    return path if count == 1 else path / f"{prefix}-{number:04d}.parquet"


def shard_folder(folder: Path, shard: int) -> Path:
    """The folder of a shard of the run in `folder`, with a spool of its own; that of the first is the run's."""
    return folder / SPOOL / _SHARD.format(shard) if shard else folder


def shard_folders(folder: Path) -> list[Path]:
    """The folders of all shards of a run in progress, in the order of their numbers."""
    others = (folder / SPOOL).glob(_SHARD.format("*"))
    return [folder, *sorted((one for one in others if one.is_dir()), key=lambda one: _shard_number(one.name))]


def _shard_number(name: str) -> int:
    number = name.rpartition("-")[2]
    return int(number) if number.isdecimal() else 0


def closed_part_path(folder: Path, table: str, segment: int) -> Path:
    """The closed part that replaces the segments of a table's spool up to `segment`."""
    return folder / SPOOL / f"{table}-{segment:04d}.parquet"


class SpoolFile(NamedTuple):
    """A closed part, or a segment of the spool."""

    number: int
    """Of a segment its number, of a part that of the last segment that it replaces."""
    path: Path
    closed: bool


def spool_files(folder: Path, table: str) -> list[SpoolFile]:
    """The files of a table of a run in progress in `folder`, in the order of their rows.

    Segments that a closed part replaces are left out, if they have not been deleted yet.
    """
    # segments first: one that is replaced meanwhile is then found as a part
    segments = _numbered(folder / SPOOL, f"{table}-*.arrows")
    parts = _numbered(folder / SPOOL, f"{table}-*.parquet")
    last = max(parts, default=-1)
    return [SpoolFile(number, path, True) for number, path in sorted(parts.items())] + [
        SpoolFile(number, path, False) for number, path in sorted(segments.items()) if number > last
    ]


def _numbered(folder: Path, pattern: str) -> dict[int, Path]:
    matches = ((path, _NUMBERED.search(path.name)) for path in folder.glob(pattern))
    return {int(match[1]): path for path, match in matches if match}
