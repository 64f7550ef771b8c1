"""Names of the files that hold a table: one Parquet file, a folder of part files, or closed parts and an open spool."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, NamedTuple

from skyrange.record.spool import SPOOL

OPEN: Final = ".new"
"""Suffix of a Parquet file that is still being written, in the spool's folder."""

_NUMBERED: Final = re.compile(r"-(\d{4,})\.(arrows|parquet)$")


def table_files(path: Path) -> list[Path]:
    """The Parquet files of the table `path`, such as `frames.parquet`: the file itself, or if it is a folder, its parts
    in order; none if it does not exist.
    """
    if path.is_dir():
        return [part for _, part in sorted(_numbered(path, "part-*.parquet").items())]
    return [path] if path.exists() else []


def part_path(path: Path, number: int, count: int) -> Path:
    """Where part `number` of the `count` parts of the table `path` belongs: a table of one part is one file."""
    return path if count == 1 else path / f"part-{number:04d}.parquet"


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
