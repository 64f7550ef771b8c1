"""What splits of a data set share although each has to be new to the others: seeds, flights and windows."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Final

import pyarrow.compute as pc
import pyarrow.parquet as pq

from skyrange.dataset.audit.classifier import LeakFinding
from skyrange.dataset.columns import WINDOW_KEYS
from skyrange.dataset.description.contents import RUNS

NAME: Final = "shared by splits"


def find_crossings(folder: Path) -> LeakFinding:
    """Seeds, flights and contents of windows that occur in two splits of a data set.

    Windows count with their times: two that are equal at the same time of two runs are one observation. Those that the
    data set marks as duplicates are left out, as by whoever uses it.
    """
    runs = pq.read_table(folder / RUNS).to_pylist()
    told: list[str] = []
    for column in ("seed", "flight"):
        by_split: dict[str, set[str]] = {}
        for row in runs:
            if row.get(column) not in (None, ""):
                by_split.setdefault(str(row.get("split", "")), set()).add(str(row[column]))
        told += [f"{column} of {text}" for text in _overlaps(by_split)]
    windows = 0
    for view in WINDOW_KEYS:
        hashes: dict[str, set[str]] = {}
        for path in sorted(folder.glob(f"view={view}/split=*/*.parquet")):
            split = path.parent.name.partition("=")[2]
            hashes.setdefault(split, set()).update(_hashes(path))
        windows += sum(map(len, hashes.values()))
        told += [f"{view} windows of {text}" for text in _overlaps(hashes)]
    blocks = len({row["block"] for row in runs})
    return LeakFinding(NAME, windows, blocks, None, None, None, tuple(told), differing={})


def _hashes(path: Path) -> set[str]:
    table = pq.ParquetFile(path).read(columns=["content_hash", "duplicate_of"])
    own = table.filter(pc.is_null(table.column("duplicate_of"))).column("content_hash")
    return {one for one in own.unique().to_pylist() if one}


def _overlaps(by_split: dict[str, set[str]]) -> Iterator[str]:
    """For each two splits with something in common, how much of the smaller one that is."""
    for one, two in combinations(sorted(by_split), 2):
        common = len(by_split[one] & by_split[two])
        if common:
            small, large = sorted((one, two), key=lambda name: len(by_split[name]))
            share = 100.0 * common / len(by_split[small])
            yield f"{small} in {large}: {common} ({share:.0f} %)"
