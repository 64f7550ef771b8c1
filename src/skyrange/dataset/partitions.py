"""Partitions of a data set: one Parquet file for each view, split and block."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.core.files import DRAFT
from skyrange.dataset.columns import VIEWS, WINDOW_KEYS, check_table, view_schema
from skyrange.dataset.members import Member
from skyrange.dataset.windows import SplitHashes, WindowHashes, begin_rows


def partition_path(folder: Path, view: str, split: str, block: str) -> Path:
    """Where the rows of a block are: `view=…/split=…/<block>.parquet`."""
    return folder / f"view={view}" / f"split={split}" / f"{block}.parquet"


class BlockWriter:
    """The files of one block; a context manager that closes them. Until then they have other names."""

    def __init__(self, folder: Path, block: str, split: str, elsewhere: SplitHashes) -> None:
        self._folder, self._block, self._split = folder, block, split
        self._files: dict[Path, pq.ParquetWriter] = {}
        self._hashes = WindowHashes(split, elsewhere)

    def __enter__(self) -> BlockWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for file in self._files.values():
            file.close()
        for path in self._files:
            if error is None:
                _draft(path).replace(path)
            else:
                _draft(path).unlink(missing_ok=True)

    def write(self, view: str, member: Member, table: pa.Table) -> int:
        """Append rows of a run, which are whole windows; returns how many. Without rows there is no file: Hugging Face
        `datasets` reads no split that is empty.

        Raises `ComponentError` where they differ from the declared columns, `OSError` where the disk is full.
        """
        if not table.num_rows:
            return 0
        if view in WINDOW_KEYS:
            table = self._hashes.mark(view, member.run, table)
        table = check_table(view, begin_rows(table, member.run, member.block, member.arm))
        path = partition_path(self._folder, view, self._split, self._block)
        if path not in self._files:
            path.parent.mkdir(parents=True, exist_ok=True)
            names = [one.name for one in VIEWS[view] if one.type == pa.string()]
            self._files[path] = pq.ParquetWriter(
                _draft(path), view_schema(view), compression="zstd", use_dictionary=names
            )
        self._files[path].write_table(table, row_group_size=131_072)
        return int(table.num_rows)


def _draft(path: Path) -> Path:
    return path.with_name(path.name + DRAFT)
