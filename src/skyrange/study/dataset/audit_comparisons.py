"""Comparisons that an audit makes of a data set: metadata, windows before the onset, and sham against attacked."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from skyrange.core.errors import InputError
from skyrange.study.dataset.audit import Comparison, LeakFinding, audit_comparison
from skyrange.study.dataset.columns import VIEWS, WINDOW_KEYS, observable_columns
from skyrange.study.dataset.families import TIMING_KINDS
from skyrange.study.dataset.windows import WINDOW_NS

IDENTIFIERS: Final = ("src", "dst", "system", "component", "mac", "uas_id", "operator_id", "transport", "channel")
"""Observable columns with ids and addresses."""
SHAPE: Final = (
    "received", "frames", "bytes", "size_mean", "size_std", "size_min", "size_max", "iat_mean_ms", "iat_std_ms",
    "iat_min_ms", "iat_max_ms", "invalid", "signed", "senders", "sequence_gaps",
)  # fmt: skip
"""Columns of `flows` on timing, length and addresses, in which a sham equals its attack."""
_GRID_NS: Final = 10_000_000
_DIGITS: Final = 8
_SAMPLE: Final = 500
_NEVER: Final = 2**62


@dataclass(frozen=True, slots=True)
class ArmOfBlock:
    """What an audit has to know of one run."""

    run: str
    block: str
    role: str
    """attacked, sham or nominal, by its episodes."""
    kinds: frozenset[str]
    onset_ns: int
    effect_ns: int


def audit_dataset(folder: Path, seed: int = 0, exempt: Collection[str] | None = None) -> list[LeakFinding]:
    """Audit the data set in `folder`: one finding for each comparison that its arms allow.

    Blocks with attacks of the kinds in `exempt` are left out of the comparison of timing with shams, and named; by
    default these are the shipped kinds that change timing or load. Raises `InputError` for a folder that is no data
    set, or if scikit-learn is not installed.
    """
    return [audit_comparison(one, seed) for one in comparisons_of(folder, TIMING_KINDS if exempt is None else exempt)]


def comparisons_of(folder: Path, exempt: Collection[str]) -> Iterator[Comparison]:
    """The comparisons, each read when it is asked for."""
    pairs = [own for own in _by_block(read_arms(folder)).values() if len({arm.role == "attacked" for arm in own}) == 2]
    arms = [arm for own in pairs for arm in own]
    yield _metadata(folder, arms)
    onset = {block: min(arm.onset_ns for arm in own) for block, own in _by_block(arms).items()}
    for view in ("flows", "aircraft"):
        yield _windows(folder, f"{view} before the onset", view, arms, dict.fromkeys(onset, -1), onset,
                       [name for name in observable_columns(view) if name != "time_ns"])  # fmt: skip
    shams = {block: own for block, own in _by_block(arms).items() if any(arm.role == "sham" for arm in own)}
    left_out = sorted({kind for own in shams.values() for arm in own for kind in arm.kinds & {*exempt}})
    compared = [
        arm for own in shams.values() if not any(one.kinds & {*exempt} for one in own)
        for arm in own if arm.role != "nominal"
    ]  # fmt: skip
    if shams:
        effect = {block: min(arm.effect_ns for arm in own) for block, own in _by_block(compared).items()}
        yield _windows(folder, "sham against attacked before the effect", "flows", compared, onset, effect, SHAPE,
                       left_out)  # fmt: skip


def read_arms(folder: Path) -> list[ArmOfBlock]:
    """The runs of a data set with their roles, onsets and effects. Of a run without a known effect, `effect_ns` is
    its onset: what follows could be the effect.
    """
    if not (folder / "runs.parquet").is_file():
        raise InputError.one("dataset", str(folder), "no runs.parquet", "the folder of a data set")
    episodes: dict[str, list[dict[str, Any]]] = {}
    for path in sorted(folder.glob("view=episodes/split=*/*.parquet")):
        for row in pq.ParquetFile(path).read().to_pylist():
            if row["role"] != "fault":
                episodes.setdefault(row["run"], []).append(row)
    found = []
    for row in pq.read_table(folder / "runs.parquet", columns=["run", "block"]).to_pylist():
        own = episodes.get(row["run"], [])
        roles = {one["role"] for one in own}
        role = "attacked" if "attack" in roles else "sham" if "sham" in roles else "nominal"
        onset_ns = min((one["onset_ns"] for one in own), default=_NEVER)
        effects = [one["effect_ns"] for one in own if one["effect_ns"] is not None]
        kinds = frozenset(str(one["kind"]) for one in own)
        effect_ns = min(effects, default=onset_ns if role == "attacked" else _NEVER)
        found.append(ArmOfBlock(row["run"], row["block"], role, kinds, onset_ns, effect_ns))
    return found


def _by_block(arms: Sequence[ArmOfBlock]) -> dict[str, list[ArmOfBlock]]:
    blocks: dict[str, list[ArmOfBlock]] = {}
    for arm in arms:
        blocks.setdefault(arm.block, []).append(arm)
    return blocks


def _files(folder: Path, view: str, block: str) -> list[Path]:
    return sorted(folder.glob(f"view={view}/split=*/{block}.parquet"))


def _windows(
    folder: Path, name: str, view: str, arms: Sequence[ArmOfBlock], begin_ns: Mapping[str, int],
    end_ns: Mapping[str, int], columns: Sequence[str], exempt: Sequence[str] = (),
) -> Comparison:  # fmt: skip
    """The rows of some runs from the window after `begin_ns` up to that before `end_ns` of their block, as numbers."""
    parts, attacked, blocks = [np.empty((0, len(columns)))], [], []
    for block, own in _by_block(arms).items():
        for path in _files(folder, view, block):
            table = pq.ParquetFile(path).read()
            inside = pc.and_(
                pc.greater(table.column("time_ns"), begin_ns[block]), pc.less_equal(_end_ns(view, table), end_ns[block])
            )
            for arm in own:
                rows = table.filter(pc.and_(inside, pc.equal(table.column("run"), arm.run)))
                parts.append(np.column_stack([_numbers(rows.column(column)) for column in columns]))
                attacked += [arm.role == "attacked"] * rows.num_rows
                blocks += [block] * rows.num_rows
    return Comparison(name, columns, np.concatenate(parts), np.array(attacked, dtype=np.bool_), blocks, exempt)


def _end_ns(view: str, table: pa.Table) -> pa.ChunkedArray:
    """When each row ends: one of `flows` lasts a window from its time, one of another view is of its time."""
    return pc.add(table.column("time_ns"), WINDOW_NS if view == "flows" else 0)


def _metadata(folder: Path, arms: Sequence[ArmOfBlock]) -> Comparison:
    """One row for each run: counts, sizes, identifiers, time grid and decimals up to the effect; attacked against
    sham, or against nominal where a block has no sham.
    """
    rows: list[dict[str, float]] = []
    attacked, blocks = [], []
    for block, own in _by_block(arms).items():
        other = "sham" if any(arm.role == "sham" for arm in own) else "nominal"
        cut_ns = min(arm.effect_ns for arm in own)
        tables = {
            view: pa.concat_tables([pq.ParquetFile(path).read() for path in found])
            for view in WINDOW_KEYS
            if (found := _files(folder, view, block))
        }
        for arm in own:
            if arm.role not in ("attacked", other):
                continue
            row: dict[str, float] = {}
            for view, table in tables.items():
                mine = table.filter(pc.equal(table.column("run"), arm.run))
                if view in ("flows", "aircraft"):
                    row[f"{view} rows"] = mine.num_rows  # a row for each window, whatever happens
                row |= describe_metadata(view, mine.filter(pc.less_equal(_end_ns(view, mine), cut_ns)))
            rows.append(row)
            attacked.append(arm.role == "attacked")
            blocks.append(block)
    columns = sorted({name for row in rows for name in row})
    values = np.array([[row.get(name, np.nan) for name in columns] for row in rows]).reshape(len(rows), len(columns))
    return Comparison("metadata", columns, values, np.array(attacked, dtype=np.bool_), blocks)


def describe_metadata(view: str, table: pa.Table) -> dict[str, float]:
    """Numbers on the form of a run's rows, by name: none is on what they tell of the flight."""
    times = table.column("time_ns").to_numpy()
    row = {
        f"{view} rows before the effect": float(table.num_rows),
        f"{view} bytes": float(sum(_length(table.column(name)) for name in observable_columns(view))),
    }
    if len(times):
        row[f"{view}.time_ns offset"] = float(np.mean(times % _GRID_NS))
        row[f"{view}.time_ns on the grid"] = float(np.mean(times % _GRID_NS == 0))
    for one in VIEWS[view]:
        if one.role != "observable" or not table.num_rows:
            continue
        column = table.column(one.name)
        if one.name in IDENTIFIERS:
            row[f"{view}.{one.name} different"] = float(pc.count_distinct(column).as_py())
            lengths = pc.utf8_length(column) if pa.types.is_string(one.type) else column
            row[f"{view}.{one.name} form"] = float(pc.mean(lengths).as_py() or 0.0)
        elif pa.types.is_floating(one.type):
            row[f"{view}.{one.name} decimals"] = _decimals(column)
    return row


def _length(column: pa.ChunkedArray) -> int:
    """The bytes of all texts of a column; other columns have the same length for each value."""
    if not (pa.types.is_string(column.type) or pa.types.is_binary(column.type)):
        return 0
    return int(pc.sum(pc.binary_length(column)).as_py() or 0)


def _decimals(column: pa.ChunkedArray) -> float:
    """The mean number of decimals that values need, up to 8; not a number without values."""
    values = column.drop_null().cast(pa.float64()).to_numpy()
    values = values[np.isfinite(values)]
    values = values[:: max(1, len(values) // _SAMPLE)]
    if not len(values):
        return float("nan")
    needed = np.full(len(values), _DIGITS)
    for digits in range(_DIGITS - 1, -1, -1):
        needed[np.abs(np.round(values, digits) - values) < 10.0**-_DIGITS] = digits
    return float(needed.mean())


def _numbers(column: pa.ChunkedArray) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """A column as numbers; texts by their lengths."""
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.int8())
    elif pa.types.is_string(column.type) or pa.types.is_binary(column.type):
        column = pc.binary_length(column)
    values = column.cast(pa.float64()).to_numpy()
    return np.asarray(values, dtype=np.float64)
