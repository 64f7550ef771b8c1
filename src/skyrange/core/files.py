"""Replacement of a file in one step: readers find the old one or the new one, never half of it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

DRAFT: Final = ".part"
"""What the name of a file ends with until it is whole. A process that is killed may leave one."""


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """Open a draft beside `path` for writing, and rename it to `path` at the block's end, when it is on the disk.

    An exception within the block, an interrupt too, removes the draft and leaves what was at `path`. Raises `OSError`
    where the disk refuses. Not for two writers of one `path` at once.
    """
    draft = path.with_name(path.name + DRAFT)
    try:
        with draft.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
