"""Results of a study: a partitioned Parquet set for each table, and which of its blocks are independent."""

from __future__ import annotations

import shutil
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.core.errors import InputError
from skyrange.core.parquet_files import name_damaged_file, read_table
from skyrange.statistics.clusters import find_clusters
from skyrange.study.design.blocks import Block
from skyrange.study.folder import StudyFolder
from skyrange.study.measurement import TABLES

RESULTS: Final = "results"
_PART_BLOCKS: Final = 2_000
"""Blocks in one file of a partition."""


def write_results(folder: StudyFolder) -> Path:
    """Write the results of all finished blocks to `results/TABLE/arm=ARM/part-0000.parquet`; returns `results`.

    Rows are in order of the design, and files do not depend on the order in which blocks were flown.
    """
    target, draft = folder.path / RESULTS, folder.path / f"{RESULTS}.part"
    shutil.rmtree(draft, ignore_errors=True)
    finished = folder.finished()
    for number, start in enumerate(range(0, len(finished), _PART_BLOCKS)):
        rows = _rows_of(folder, finished[start : start + _PART_BLOCKS])
        for table in TABLES:
            for arm in folder.study.arms:
                arm_rows = [row for row in rows[table] if row["arm"] == arm.id]
                if arm_rows:
                    _write(arm_rows, draft / table / f"arm={arm.id}" / f"part-{number:04d}.parquet")
    draft.mkdir(exist_ok=True)
    shutil.rmtree(target, ignore_errors=True)
    draft.replace(target)
    return target


def read_results(folder: Path | str, table: str) -> pa.Table:
    """One table of the results of the study in a folder: runs, aircraft, effects, alerts or acts; empty without rows.

    Raises `InputError` for a table that does not exist.
    """
    if table not in TABLES:
        raise InputError.one("study", "table", table, f"one of {', '.join(TABLES)}")
    path = Path(folder) / RESULTS / table
    if not path.is_dir():
        return pa.table({})
    who = str(folder)
    parts = [read_table(file, who, str(file.relative_to(folder))) for file in sorted(path.rglob("*.parquet"))]
    with name_damaged_file(who, f"{RESULTS}/{table}"):  # parts whose columns have other types
        return pa.concat_tables(parts, promote_options="permissive") if parts else pa.table({})


def _rows_of(folder: StudyFolder, blocks: Sequence[Block]) -> dict[str, list[dict[str, Any]]]:
    rows: dict[str, list[dict[str, Any]]] = {table: [] for table in TABLES}
    for block in blocks:
        block_rows = folder.read_rows(block)
        for table in TABLES:
            rows[table] += block_rows[table]
    return rows


def _write(rows: list[dict[str, Any]], path: Path) -> None:
    names = list(dict.fromkeys(_columns(rows)))
    columns = {name: [row.get(name) for row in rows] for name in names}
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table({name: _array(values) for name, values in columns.items()}), path, compression="zstd")


def _columns(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    for row in rows:
        yield from row


def _array(values: list[Any]) -> pa.Array:
    """A column: numbers are floats where any is; what has several types is text."""
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} and float in kinds:
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    if len(kinds) > 1 or kinds & {list, dict}:
        return pa.array([None if value is None else str(value) for value in values], pa.string())
    return pa.array(values)


def cluster_blocks(folder: StudyFolder, runs: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """The cluster of each block of a study, by the name of the cluster's first block: those that share a seed or any
    flight, of which no part may be in two splits. `runs` are rows of that table.

    Points that are flown with the same seeds are one cluster for each seed.
    """
    shared: dict[str, list[Hashable]] = {block.name: [("seed", block.seed)] for block in folder.blocks}
    for row in runs:
        if row.get("flight"):
            shared[row["block"]].append(("flight", row["flight"]))
    return find_clusters(shared)


def cluster_samples(folder: StudyFolder, runs: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """The cluster of each block of a study as a sample of a mean: those that share a seed, or all of their flights.

    Blocks of two seeds with one nominal flight and different attacked ones are two samples of the difference. Where
    nothing at all depends on the seed, they are one.
    """
    flights: dict[str, set[tuple[str, str]]] = {}
    for row in runs:
        flights.setdefault(row["block"], set()).add((row["arm"], row.get("flight") or ""))
    shared: dict[str, list[Hashable]] = {}
    for block in folder.blocks:
        block_flights = flights.get(block.name, set())
        all_known = len(block_flights) == len(folder.study.arms) and all(flight for _, flight in block_flights)
        shared[block.name] = [("seed", block.seed), *([("flights", tuple(sorted(block_flights)))] if all_known else [])]
    return find_clusters(shared)
