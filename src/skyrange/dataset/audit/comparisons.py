"""Comparisons that an audit makes of a data set: metadata, windows before the onset, and sham against attacked."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from hashlib import blake2b
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from skyrange.dataset.audit.arms import ArmOfBlock, cut_at_faults, group_by_block, read_arms
from skyrange.dataset.audit.classifier import Comparison, LeakFinding, audit_comparison
from skyrange.dataset.audit.crossings import find_crossings
from skyrange.dataset.audit.metadata import describe_metadata
from skyrange.dataset.audit.shape import SHAPE, describe_shape
from skyrange.dataset.columns import WINDOW_KEYS, observable_columns
from skyrange.dataset.families import TIMING_KINDS
from skyrange.dataset.windows import WINDOW_NS

Blocks = Mapping[str, Sequence[ArmOfBlock]]


def audit_dataset(folder: Path, seed: int = 0, exempt: Collection[str] | None = None) -> list[LeakFinding]:
    """Audit the data set in `folder`: one finding for each comparison that its arms allow, and one on its splits.

    Attacks of the kinds in `exempt` are compared up to their onset only, and named; by default these are the shipped
    kinds that change timing or load. Raises `InputError` for a folder that is no data set, or if scikit-learn is not
    installed.
    """
    compared = comparisons_of(folder, TIMING_KINDS if exempt is None else exempt)
    return [*(audit_comparison(one, seed) for one in compared), find_crossings(folder)]


def comparisons_of(folder: Path, exempt: Collection[str]) -> Iterator[Comparison]:
    """The comparisons, each read when it is asked for."""
    arms = read_arms(folder)
    every = group_by_block(arms)
    others = len(arms) - sum(map(len, every.values()))
    unlike = [f"{others} runs of other settings"] if others else []
    blocks = {block: own for block, own in every.items() if len({arm.role == "attacked" for arm in own}) == 2}
    kinds = {block: frozenset().union(*(arm.kinds for arm in own)) for block, own in blocks.items()}
    left_out = sorted({kind for own in kinds.values() for kind in own & {*exempt}})
    shams = {block: own for block, own in blocks.items() if any(arm.role == "sham" for arm in own)}
    compared = {block: own for block, own in shams.items() if not kinds[block] & {*exempt}}
    yield _metadata(folder, blocks, compared, [*left_out, *unlike])
    for view in ("flows", "aircraft"):
        yield _before_onset(folder, view, blocks, unlike)
    if shams:
        yield _shams(folder, compared, [*left_out, *unlike])


def _files(folder: Path, view: str, block: str) -> list[Path]:
    return sorted(folder.glob(f"view={view}/split=*/{block}.parquet"))


def _read_block(folder: Path, view: str, block: str, columns: Sequence[str] | None = None) -> pa.Table | None:
    found = [pq.ParquetFile(path).read(columns=columns) for path in _files(folder, view, block)]
    return pa.concat_tables(found) if found else None


def _metadata(folder: Path, blocks: Blocks, compared: Blocks, exempt: Sequence[str]) -> Comparison:
    """One row for each run: attacked and sham up to the effect, or where there is no sham to compare with, attacked and
    nominal up to the onset.
    """
    rows: list[dict[str, float]] = []
    attacked, names, runs = [], [], []
    for block, own in blocks.items():
        other = "sham" if block in compared else "nominal"
        chosen = [arm for arm in own if arm.role in ("attacked", other)]
        if len({arm.role for arm in chosen}) < 2:  # an attack that is exempt, and its sham
            chosen = list(own)
        chosen = cut_at_faults(chosen)
        onset_ns = min(arm.onset_ns for arm in chosen)
        cut_ns = min(arm.effect_ns for arm in chosen) if block in compared else onset_ns
        tables = {view: table for view in WINDOW_KEYS if (table := _read_block(folder, view, block)) is not None}
        for arm in chosen:
            row: dict[str, float] = {}
            for view, table in tables.items():
                mine = pc.equal(table.column("run"), arm.run)
                if view in ("flows", "aircraft"):
                    row[f"{view} rows of the run"] = pc.sum(mine).as_py()  # a row for each window, whatever happens
                ends = _end_ns(view, table)
                early, before = (pc.and_(mine, pc.less_equal(ends, time_ns)) for time_ns in (cut_ns - 1, onset_ns - 1))
                row |= describe_metadata(view, table.filter(early), table.filter(before))
            rows.append(row)
            attacked.append(arm.role == "attacked")
            names.append(block)
            runs.append(arm.run)
    columns = sorted({name for row in rows for name in row})
    values = np.array([[row.get(name, np.nan) for name in columns] for row in rows]).reshape(len(rows), len(columns))
    is_attacked = np.array(attacked, dtype=np.bool_)
    return Comparison("metadata", columns, values, is_attacked, names, runs, _repeats(blocks), exempt)


def _before_onset(folder: Path, view: str, blocks: Blocks, exempt: Sequence[str]) -> Comparison:
    """The windows that end before the first act of any arm of the block."""
    columns = [name for name in observable_columns(view) if name != "time_ns"]
    parts, attacked, names, runs = [np.empty((0, len(columns)))], [], [], []
    for block, every in blocks.items():
        own, table = cut_at_faults(every), _read_block(folder, view, block)
        if table is None:
            continue
        table = table.filter(pc.less(_end_ns(view, table), min(arm.onset_ns for arm in own)))
        for arm in own:
            rows = table.filter(pc.equal(table.column("run"), arm.run))
            parts.append(np.column_stack([_numbers(rows.column(column)) for column in columns]))
            attacked += [arm.role == "attacked"] * rows.num_rows
            names += [block] * rows.num_rows
            runs += [arm.run] * rows.num_rows
    values, is_attacked = np.concatenate(parts), np.array(attacked, dtype=np.bool_)
    return Comparison(f"{view} before the onset", columns, values, is_attacked, names, runs, _repeats(blocks), exempt)


def _shams(folder: Path, blocks: Blocks, exempt: Sequence[str]) -> Comparison:
    """Timing, lengths and senders of frames from the onset up to the effect."""
    parts, attacked, names, runs = [np.empty((0, len(SHAPE)))], [], [], []
    for block, every in blocks.items():
        own = cut_at_faults([arm for arm in every if arm.role in ("attacked", "sham")])
        roles = {arm.run: arm.role for arm in own}
        frames = _read_block(folder, "mavlink", block)
        if frames is None:
            continue
        frames = frames.filter(pc.is_in(frames.column("run"), value_set=pa.array(list(roles))))
        onset_ns, effect_ns = min(arm.onset_ns for arm in own), min(arm.effect_ns for arm in own)
        if not frames.num_rows or effect_ns <= onset_ns:
            continue
        rows = describe_shape(frames, onset_ns, effect_ns)
        parts.append(np.column_stack([_numbers(rows.column(column)) for column in SHAPE]))
        attacked += [roles[run] == "attacked" for run in rows.column("run").to_pylist()]
        names += [block] * rows.num_rows
        runs += rows.column("run").to_pylist()
    values, is_attacked = np.concatenate(parts), np.array(attacked, dtype=np.bool_)
    name = "sham against attacked before the effect"
    return Comparison(name, SHAPE, values, is_attacked, names, runs, _repeats(blocks), exempt)


def _repeats(blocks: Blocks) -> bool:
    """Whether all runs repeat to the byte."""
    return all(arm.repeats for own in blocks.values() for arm in own)


def _end_ns(view: str, table: pa.Table) -> pa.ChunkedArray:
    """The last time of which each row tells: one of `flows` lasts a window from its time."""
    return pc.add(table.column("time_ns"), WINDOW_NS - 1 if view == "flows" else 0)


def _numbers(column: pa.ChunkedArray) -> NDArray[np.float64]:
    """A column as numbers; texts by their contents: a number that is the same for the same text in every run."""
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.int8())
    elif pa.types.is_string(column.type) or pa.types.is_binary(column.type):
        return np.array([np.nan if one is None else _number_text(one) for one in column.to_pylist()], dtype=np.float64)
    values = column.cast(pa.float64()).to_numpy()
    return np.asarray(values, dtype=np.float64)


@lru_cache(maxsize=65_536)
def _number_text(text: str | bytes) -> float:
    data = text if isinstance(text, bytes) else text.encode()
    return float(int.from_bytes(blake2b(data, digest_size=6).digest()))
