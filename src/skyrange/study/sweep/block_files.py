"""Files of finished blocks, in a study's folder: the result of a block and the rows that it measured."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final, NamedTuple

from skyrange.core.errors import InputError
from skyrange.core.files import MAX_RECORD_BYTES, atomic_write, read_input
from skyrange.study.sweep.measurement import Rows

BLOCKS: Final = "blocks"
"""Folder of a file for each finished block."""
RUNS: Final = "runs"
"""Folder of the runs: those that are kept, and those of blocks that are not finished."""
KEPT: Final = "kept"
"""Folder of the tables that are kept of runs whose folders are not."""
_FORMAT: Final = "skyrange.block/2"
"""Blocks of `skyrange.block/1` have delays between reports of ground stations, by heartbeats."""


class BlockResult(NamedTuple):
    """What is known of a block that was flown."""

    name: str
    runs: int
    failed: int
    errors: tuple[str, ...]
    wall_s: float
    """Of everything."""
    flight_s: float
    """Of the flights themselves."""
    disk_bytes: int
    """What its kept files take."""


def write_block(root: Path, result: BlockResult, rows: Rows) -> None:
    """Write the file of a finished block: it is there as a whole or not at all."""
    data = {"format": _FORMAT, **result._asdict(), "rows": rows}
    with atomic_write(root / BLOCKS / f"{result.name}.json") as file:
        file.write(json.dumps(data, allow_nan=True).encode())


def read_block(path: Path) -> tuple[BlockResult, Rows]:
    """A finished block. Raises `InputError` for a damaged file."""
    try:
        data: dict[str, Any] = json.loads(read_input(path, "study", max_bytes=MAX_RECORD_BYTES))
        if data.pop("format") != _FORMAT:
            raise ValueError("another format")
        rows: Rows = data.pop("rows")
        return BlockResult(**{**data, "errors": tuple(data["errors"])}), rows
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError.one(
            "study", str(path), str(error), f"the file of a block, {_FORMAT}", "Delete it and resume."
        ) from error
