"""Comparisons that an audit makes: metadata, windows before the onset, sham against attacked, and between splits."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import lru_cache
from hashlib import blake2b
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.core.time import Time
from skyrange.dataset.audit.arms import ArmOfBlock, cut_at_faults, group_by_block, read_arms
from skyrange.dataset.audit.classifier import Comparison, LeakFinding, audit_comparison
from skyrange.dataset.columns import VIEWS, WINDOW_KEYS, observable_columns
from skyrange.dataset.families import TIMING_KINDS
from skyrange.dataset.reading import read_runs, read_view
from skyrange.dataset.windows import WINDOW_NS

NAME: Final = "shared by splits"


def find_crossings(folder: Path) -> LeakFinding:
    """Seeds, flights and contents of windows that occur in two splits of a data set.

    Windows count with their times: two that are equal at the same time of two runs are one observation. Those that the
    data set marks as duplicates are left out, as by whoever uses it.
    """
    runs = read_runs(folder)
    shared: list[str] = []
    for column in ("seed", "flight"):
        by_split: dict[str, set[str]] = {}
        for row in runs:
            if row.get(column) not in (None, ""):
                by_split.setdefault(str(row.get("split", "")), set()).add(str(row[column]))
        shared += [f"{column} of {text}" for text in _overlaps(by_split)]
    windows = 0
    for view in WINDOW_KEYS:
        hashes: dict[str, set[str]] = {}
        for path in sorted(folder.glob(f"view={view}/split=*/*.parquet")):
            split = path.parent.name.partition("=")[2]
            hashes.setdefault(split, set()).update(_hashes(folder, view, path))
        windows += sum(map(len, hashes.values()))
        shared += [f"{view} windows of {text}" for text in _overlaps(hashes)]
    blocks = len({row["block"] for row in runs})
    return LeakFinding(NAME, windows, blocks, None, None, None, tuple(shared), differing={})


def _hashes(folder: Path, view: str, path: Path) -> set[str]:
    table = read_view(folder, view, path, ["content_hash", "duplicate_of"])
    hashes = table.filter(pc.is_null(table.column("duplicate_of"))).column("content_hash")
    return {value for value in hashes.unique().to_pylist() if value}


def _overlaps(by_split: dict[str, set[str]]) -> Iterator[str]:
    """For each two splits with something in common, how much of the smaller one that is."""
    for first, second in combinations(sorted(by_split), 2):
        common = len(by_split[first] & by_split[second])
        if common:
            small, large = sorted((first, second), key=lambda name: len(by_split[name]))
            share = 100.0 * common / len(by_split[small])
            yield f"{small} in {large}: {common} ({share:.0f} %)"


_MEANS: Final = ("valid", "signed")
_SPREADS: Final = ("size", "iat_ms")
_HOW: Final = ("mean", "stddev", "min", "max")
SHAPE: Final = (
    "received", "frames", "bytes", *(f"{name}_{statistic}" for name in _SPREADS for statistic in _HOW), *_MEANS,
    "senders", "message_kinds", "sequence_gaps",
)  # fmt: skip
"""Names of the numbers; in all of them a sham equals its attack."""
_PLACE: Final = ("place", "link", "received")


def describe_shape(frames: pa.Table, begin_ns: Time, end_ns: Time) -> pa.Table:
    """A row for each run, place, direction and second of [begin, end), also without frames, with the columns `SHAPE`.

    `frames` are rows of the view `mavlink` in order of time, of at least one run. The last second may be a part of one.
    Attacks often have their effect within a second; the windows of `flows` would be too long for them.
    """
    time_ns = frames.column("time_ns")
    inside = frames.filter(pc.and_(pc.greater_equal(time_ns, begin_ns), pc.less(time_ns, end_ns)))
    latest = int(pc.max(time_ns).as_py() or 0)
    seconds = -(-max(0, min(end_ns, latest + 1) - begin_ns) // WINDOW_NS)
    cells = _every_cell(frames, seconds)
    keys = ["run", *_PLACE, "second"]
    second = pc.cast(pc.divide(pc.subtract(inside.column("time_ns"), begin_ns), WINDOW_NS), pa.int64())
    inside = _mark(inside.append_column("second", second), keys)
    counted = inside.group_by(keys).aggregate(
        [
            ("size", "count"), ("size", "sum"), *((name, statistic) for name in _SPREADS for statistic in _HOW),
            *((name, "mean") for name in (*_MEANS, "gap")), ("sender", "count_distinct"),
            ("message_id", "count_distinct"),
        ]
    )  # fmt: skip
    renamed = {"size_count": "frames", "size_sum": "bytes", "sender_count_distinct": "senders",
               "message_id_count_distinct": "message_kinds", "gap_mean": "sequence_gaps",
               **{f"{name}_mean": name for name in _MEANS}}  # fmt: skip
    counted = counted.rename_columns([renamed.get(name, name) for name in counted.column_names])
    joined = cells.join(counted, keys, join_type="left outer").sort_by([(key, "ascending") for key in keys])
    place = joined.column_names.index("frames")
    return joined.set_column(place, "frames", pc.fill_null(joined.column("frames"), 0))


def _every_cell(frames: pa.Table, seconds: int) -> pa.Table:
    runs = frames.column("run").unique().to_pylist()
    places = frames.group_by(list(_PLACE)).aggregate([]).to_pylist()
    return pa.Table.from_pylist(
        [{"run": run, **place, "second": second} for run in runs for place in places for second in range(seconds)],
        schema=pa.schema([*(frames.schema.field(name) for name in ("run", *_PLACE)), ("second", pa.int64())]),
    )


def _mark(frames: pa.Table, keys: list[str]) -> pa.Table:
    """The frames with the claimed sender, the time since the previous one of the same cell, and whether its sequence
    number does not follow that of its sender's previous one.
    """
    sender = pc.add(pc.multiply(frames.column("system").cast(pa.int32()), 256), frames.column("component"))
    frames = frames.append_column("sender", pc.fill_null(sender, -1))
    frames = frames.sort_by([*((key, "ascending") for key in keys), ("time_ns", "ascending")])
    between = np.diff(frames.column("time_ns").to_numpy(), prepend=0) / 1e6
    between[_is_first(frames, keys)] = np.nan
    frames = frames.append_column("iat_ms", pa.array(between, from_pandas=True))
    frames = frames.sort_by([*((key, "ascending") for key in (*keys[:-1], "sender")), ("time_ns", "ascending")])
    steps = np.diff(pc.fill_null(frames.column("sequence"), 0).to_numpy().astype(np.int64), prepend=0) & 0xFF
    gap = (steps != 1) & ~_is_first(frames, [*keys[:-1], "sender"])
    return frames.append_column("gap", pa.array(gap.astype(np.float64)))


def _is_first(frames: pa.Table, keys: list[str]) -> NDArray[np.bool_]:
    """(n,) whether a row is the first of its equal keys, which stand together."""
    first = np.zeros(frames.num_rows, dtype=np.bool_)
    first[:1] = True
    for key in keys:
        codes = pc.fill_null(frames.column(key).combine_chunks().dictionary_encode().indices, -1).to_numpy()
        first[1:] |= codes[1:] != codes[:-1]
    return first


IDENTIFIERS: Final = ("src", "dst", "system", "component", "mac", "uas_id", "operator_id", "transport", "channel")
"""Observable columns with ids and addresses."""
_GRIDS_NS: Final = {"1 us": 1_000, "1 ms": 1_000_000, "10 ms": 10_000_000}
_DIGITS: Final = 8
_SAMPLE: Final = 500
_NUMBER: Final = re.compile(r"\d+")


def describe_metadata(view: str, table: pa.Table, before: pa.Table) -> dict[str, float]:
    """Numbers on the form of a run's rows, by name: none is on what they tell of the flight.

    The precision of values is that of the rows `before` the onset: from then on they tell other things, which need
    other decimals.
    """
    times = table.column("time_ns").to_numpy()
    row = {
        f"{view} rows": float(table.num_rows),
        f"{view} bytes": float(sum(_length(table.column(name)) for name in observable_columns(view))),
    }
    if len(times):
        row[f"{view}.time_ns first"] = float(times.min())
        row[f"{view}.time_ns offset"] = float(np.mean(times % max(_GRIDS_NS.values())))
        row |= {f"{view}.time_ns on {name}": float(np.mean(times % grid == 0)) for name, grid in _GRIDS_NS.items()}
    for column in VIEWS[view]:
        if column.role != "observable" or not table.num_rows:
            continue
        described: dict[str, float] = {}
        if column.name in IDENTIFIERS:
            described = _describe_identifiers(table.column(column.name))
        elif pa.types.is_floating(column.type):
            described = _describe_precision(before.column(column.name))
        row |= {f"{view}.{column.name} {name}": value for name, value in described.items()}
    return row


def _describe_identifiers(column: pa.ChunkedArray) -> dict[str, float]:
    """How many different ones, their mean length, their mean number, such as that of a port, and which set they are."""
    different: list[Any] = sorted(value for value in pc.unique(column).to_pylist() if value is not None)
    texts = [str(value) for value in different]
    numbers = [float(digits[-1]) for text in texts if (digits := _NUMBER.findall(text))]
    return {
        "different": float(len(different)),
        "length": float(np.mean([len(text) for text in texts])) if texts else 0.0,
        "number": float(np.mean(numbers)) if numbers else float("nan"),
        "values": float(int.from_bytes(blake2b("\0".join(texts).encode(), digest_size=6).digest())),
    }


def _describe_precision(column: pa.ChunkedArray) -> dict[str, float]:
    """The mean number of decimals that values need, up to 8, and the share that fits in single precision; not a number
    without values.
    """
    values = column.drop_null().cast(pa.float64()).to_numpy()
    values = values[np.isfinite(values)]
    values = values[:: max(1, len(values) // _SAMPLE)]
    if not len(values):
        return {"decimals": float("nan"), "single precision": float("nan")}
    needed = np.full(len(values), _DIGITS)
    for digits in range(_DIGITS - 1, -1, -1):
        needed[np.abs(np.round(values, digits) - values) < 10.0**-_DIGITS] = digits
    with np.errstate(over="ignore"):
        single = values.astype(np.float32).astype(np.float64) == values
    return {"decimals": float(needed.mean()), "single precision": float(single.mean())}


def _length(column: pa.ChunkedArray) -> int:
    """The bytes of all texts of a column; other columns have the same length for each value."""
    if not (pa.types.is_string(column.type) or pa.types.is_binary(column.type)):
        return 0
    return int(pc.sum(pc.binary_length(column)).as_py() or 0)


Blocks = Mapping[str, Sequence[ArmOfBlock]]


def audit_dataset(folder: Path, seed: int = 0, exempt: Collection[str] | None = None) -> list[LeakFinding]:
    """Audit the data set in `folder`: one finding for each comparison that its arms allow, and one on its splits.

    Attacks of the kinds in `exempt` are compared up to their onset only, and named; by default these are the shipped
    kinds that change timing or load. Raises `InputError` for a folder that is no data set, or if scikit-learn is not
    installed.
    """
    compared = comparisons_of(folder, TIMING_KINDS if exempt is None else exempt)
    return [*(audit_comparison(comparison, seed) for comparison in compared), find_crossings(folder)]


def comparisons_of(folder: Path, exempt: Collection[str]) -> Iterator[Comparison]:
    """The comparisons, each read when it is asked for."""
    arms = read_arms(folder)
    every = group_by_block(arms)
    others = len(arms) - sum(map(len, every.values()))
    unlike = [f"{others} runs of other settings"] if others else []
    blocks = {
        block: of_block for block, of_block in every.items() if len({arm.role == "attacked" for arm in of_block}) == 2
    }
    kinds = {block: frozenset().union(*(arm.kinds for arm in of_block)) for block, of_block in blocks.items()}
    left_out = sorted({kind for of_block in kinds.values() for kind in of_block & {*exempt}})
    shams = {block: of_block for block, of_block in blocks.items() if any(arm.role == "sham" for arm in of_block)}
    compared = {block: of_block for block, of_block in shams.items() if not kinds[block] & {*exempt}}
    yield _metadata(folder, blocks, compared, [*left_out, *unlike])
    for view in ("flows", "aircraft"):
        yield _before_onset(folder, view, blocks, unlike)
    if shams:
        yield _shams(folder, compared, [*left_out, *unlike])


def _files(folder: Path, view: str, block: str) -> list[Path]:
    return sorted(folder.glob(f"view={view}/split=*/{block}.parquet"))


def _read_block(folder: Path, view: str, block: str, columns: Sequence[str] | None = None) -> pa.Table | None:
    tables = [read_view(folder, view, path, columns) for path in _files(folder, view, block)]
    return pa.concat_tables(tables) if tables else None


def _metadata(folder: Path, blocks: Blocks, compared: Blocks, exempt: Sequence[str]) -> Comparison:
    """One row for each run: attacked and sham up to the effect, or where there is no sham to compare with, attacked and
    nominal up to the onset.
    """
    rows: list[dict[str, float]] = []
    attacked, names, runs = [], [], []
    for block, arms in blocks.items():
        other = "sham" if block in compared else "nominal"
        chosen = [arm for arm in arms if arm.role in ("attacked", other)]
        if len({arm.role for arm in chosen}) < 2:  # an attack that is exempt, and its sham
            chosen = list(arms)
        chosen = cut_at_faults(chosen)
        onset_ns = min(arm.onset_ns for arm in chosen)
        cut_ns = min(arm.effect_ns for arm in chosen) if block in compared else onset_ns
        tables = {view: table for view in WINDOW_KEYS if (table := _read_block(folder, view, block)) is not None}
        for arm in chosen:
            row: dict[str, float] = {}
            for view, table in tables.items():
                of_run = pc.equal(table.column("run"), arm.run)
                if view in ("flows", "aircraft"):
                    row[f"{view} rows of the run"] = pc.sum(of_run).as_py()  # a row for each window, whatever happens
                ends = _end_ns(view, table)
                early, before = (
                    pc.and_(of_run, pc.less_equal(ends, time_ns)) for time_ns in (cut_ns - 1, onset_ns - 1)
                )
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
        compared, table = cut_at_faults(every), _read_block(folder, view, block)
        if table is None:
            continue
        table = table.filter(pc.less(_end_ns(view, table), min(arm.onset_ns for arm in compared)))
        for arm in compared:
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
        compared = cut_at_faults([arm for arm in every if arm.role in ("attacked", "sham")])
        roles = {arm.run: arm.role for arm in compared}
        frames = _read_block(folder, "mavlink", block)
        if frames is None:
            continue
        frames = frames.filter(pc.is_in(frames.column("run"), value_set=pa.array(list(roles))))
        onset_ns, effect_ns = min(arm.onset_ns for arm in compared), min(arm.effect_ns for arm in compared)
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
    return all(arm.repeats for arms in blocks.values() for arm in arms)


def _end_ns(view: str, table: pa.Table) -> pa.ChunkedArray:
    """The last time of which each row tells: one of `flows` lasts a window from its time."""
    return pc.add(table.column("time_ns"), WINDOW_NS - 1 if view == "flows" else 0)


def _numbers(column: pa.ChunkedArray) -> NDArray[np.float64]:
    """A column as numbers; texts by their contents: a number that is the same for the same text in every run."""
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.int8())
    elif pa.types.is_string(column.type) or pa.types.is_binary(column.type):
        return np.array(
            [np.nan if value is None else _number_text(value) for value in column.to_pylist()], dtype=np.float64
        )
    values = column.cast(pa.float64()).to_numpy()
    return np.asarray(values, dtype=np.float64)


@lru_cache(maxsize=65_536)
def _number_text(text: str | bytes) -> float:
    data = text if isinstance(text, bytes) else text.encode()
    return float(int.from_bytes(blake2b(data, digest_size=6).digest()))
