"""Progress of a build: which data set a folder is being made into, and which of its blocks are whole.

The folder `.building` is there from the first step to the last. A data set without it is whole.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import InputError
from skyrange.core.files import MAX_RECORD_BYTES, atomic_write, lock_file, parse_json, read_input, refuse_links
from skyrange.core.typed_json import Count, check_type, read_object
from skyrange.record.folder import make_new_folder

BUILDING: Final = ".building"
_PLAN: Final = "plan.json"
_LOCK: Final = "lock"
_BLOCKS: Final = "blocks"

RowCounts = Mapping[str, Mapping[str, int]]
"""By run and view, the number of rows."""


@dataclass(frozen=True, slots=True)
class BuildProgress:
    """A build that is under way in `folder`."""

    folder: Path

    def read_block(self, block: str, runs: Sequence[str]) -> RowCounts | None:
        """The rows of a block that is whole, None of another. Raises `InputError` if they are not those of its runs."""
        path = self._path(block)
        if not path.is_file():
            return None
        who, where = str(self.folder), f"{BUILDING}/{_BLOCKS}/{path.name}"
        rows: RowCounts = check_type(read_object(path, who, where), dict[str, dict[str, Count]], who, where)
        if rows.keys() != {*runs}:
            hint = "Delete it and build again."
            raise InputError.one(who, where, ascii(list(rows))[:80], f"the rows of {', '.join(runs)}", hint)
        return rows

    def finish_block(self, block: str, rows: RowCounts) -> None:
        """Note that all files of a block are whole."""
        with atomic_write(self._path(block)) as file:
            file.write(json.dumps(rows).encode())

    def _path(self, block: str) -> Path:
        return self.folder / BUILDING / _BLOCKS / f"{block}.json"


@contextmanager
def begin_build(folder: Path, plan: Mapping[str, Any]) -> Iterator[BuildProgress]:
    """Begin a build in a new folder, or go on with one of the same plan; at the block's end it is whole.

    If the block raises, the blocks that are whole stay for the next time. Raises `InputError` for a folder that holds
    anything else, a build of another plan, one that another process is at, or a symbolic link.
    """
    state = folder / BUILDING
    digest = hashlib.sha256(json.dumps(plan, sort_keys=True, default=str).encode()).hexdigest()
    if state.is_dir():
        refuse_links(folder, str(folder))
        hint = "Build in another folder, or delete this one."
        if (state / _PLAN).is_file():
            data = read_input(state / _PLAN, str(folder), _PLAN, max_bytes=MAX_RECORD_BYTES)
            if parse_json(data, str(folder), _PLAN) != {"digest": digest}:
                expected = "the same runs, splits, settings and version of skyrange"
                raise InputError.one(str(folder), "data set", "begun of other runs or settings", expected, hint)
    else:
        make_new_folder(folder)
    (state / _BLOCKS).mkdir(parents=True, exist_ok=True)
    expected = "a data set that no other process is building"
    refusal = InputError.one(str(folder), "data set", "being built", expected, "Wait for it, or end it.")
    with lock_file(state / _LOCK, refusal):
        with atomic_write(state / _PLAN) as file:
            file.write(json.dumps({"digest": digest}).encode())
        yield BuildProgress(folder)
        shutil.rmtree(state / _BLOCKS)
        (state / _PLAN).unlink()
        (state / _LOCK).unlink()
        state.rmdir()


def require_whole(folder: Path) -> None:
    """Raise `InputError` for a data set whose build was interrupted."""
    if (folder / BUILDING).exists():
        hint = "The same `skyrange dataset build` goes on with it."
        raise InputError.one("dataset", str(folder), "not finished", "a data set that is whole", hint)
