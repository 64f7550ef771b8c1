"""Atomic replacement of files: readers see the old contents or the new, never a part."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

DRAFT: Final = ".part"
"""Suffix of the temporary file beside a file that is being written. A killed process may leave one."""


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path` for writing; flush it to the disk and rename it to `path` at the block's end.

    If the block raises, also `KeyboardInterrupt`, the temporary file is deleted and `path` stays as it was. Raises
    `OSError` if the file cannot be written. Two processes must not write the same `path` at once.
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
