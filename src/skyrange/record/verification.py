"""Verification of a run: its files and tables against the sizes, hashes, counts and digests in its manifest.

It finds accidents: a file that is missing, cut off, swapped or changed. Who changes a file can change the manifest too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.contracts.frames import Payloads
from skyrange.core.errors import InputError, Problem
from skyrange.core.ids import hash64
from skyrange.record.digests import Digests, Words
from skyrange.record.folder import check_file
from skyrange.record.manifest import MANIFEST
from skyrange.record.read.run import RunRecord
from skyrange.record.read.telemetry import FOLDER, count_messages
from skyrange.record.write.rows.payloads import PayloadDeduplicator
from skyrange.record.write.rows.ticks import split_ticks, truth_words

_NEVER: Final = 0xFFFFFFFFFFFFFFFF
_FLOW: Final = ("link", "direction", "sender", "src", "dst")
_WINDOW_BYTES: Final = 4 << 20


@dataclass(frozen=True, slots=True)
class Verification:
    """The result for one run. `problems` is empty if all that the manifest says is so."""

    path: str
    files: int
    """Files whose size and hash were compared."""
    tables: int
    """Tables whose rows were counted."""
    digests: tuple[str, ...]
    """Digests that were computed anew from the tables."""
    unchecked: tuple[str, ...]
    """Digests of tables that the run's level leaves out."""
    problems: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problems

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON values."""
        return {"ok": self.ok, **asdict(self)}

    def __str__(self) -> str:
        if self.problems:
            return "\n".join([f"{self.path}: not as its manifest says", *(f"  {problem}" for problem in self.problems)])
        left = f"; not checked, for want of the table: {', '.join(self.unchecked)}" if self.unchecked else ""
        digests = f"digests {', '.join(self.digests)}{left}"
        return f"{self.path}: as its manifest says: {self.files} files, {self.tables} tables, {digests}"


def verify_run(record: RunRecord) -> Verification:
    """Compare everything in a run's folder with its manifest.

    Raises `InputError` for a run that did not end, whose manifest says nothing of its rows yet.
    """
    if not record.ended or record.tables.spooled or not record.manifest.get("digests"):
        who, status = str(record.path), record.status
        raise InputError.one(who, "status", status, "a run that ended", "Its manifest has no digests of its rows yet.")
    files = record.manifest.get("files") or {}
    problems = [] if files else [f"{MANIFEST}: files: missing — expected the size and hash of each file of the run"]
    problems += [problem for name, entry in files.items() for problem in check_file(record.path, name, entry)]
    counts = record.manifest.get("counts") or {}
    for name, count in counts.items():
        problems += _check_rows(record, name, count)
    problems += _check_messages(record)
    computed: dict[str, str] = {}
    unchecked = tuple(name for name in ("frames", "truth") if not record.keeps(name))
    for name, compute in (("frames", _frames_digest), ("truth", _truth_digest), ("events", _events_digest)):
        if name in unchecked:
            continue
        try:
            computed[name] = compute(record)
        except InputError as error:
            problems += [str(problem) for problem in error.problems]
        except (pa.ArrowException, KeyError, ValueError, TypeError) as error:
            problems.append(f"{name}: {error} — expected the columns of that table")
    declared = record.manifest["digests"]
    for name, digest in computed.items():
        if digest != declared.get(name):
            problems.append(f"{name}: the digest of the rows is {digest} — expected {declared.get(name)}")
    return Verification(
        str(record.path), len(files), len(counts), tuple(computed), unchecked, tuple(dict.fromkeys(problems))
    )


def require_verified(who: str, records: Iterable[RunRecord]) -> None:
    """Raise `InputError` on behalf of `who` if a run is not as its manifest says, with a problem for each such run."""
    problems: list[Problem] = []
    for record in records:
        try:
            run_problems = verify_run(record).problems
        except InputError as error:
            problems += [replace(problem, where=f"{error.who}: {problem.where}") for problem in error.problems]
            continue
        if run_problems:
            hint = f"Fly the run again. `skyrange verify {record.path}` names all {len(run_problems)} problems."
            problems.append(Problem(str(record.path), run_problems[0], "a run that is as its manifest says", hint))
    if problems:
        raise InputError(who, problems)


def _check_rows(record: RunRecord, name: str, count: Any) -> Iterator[str]:
    try:
        rows = record.rows(name)
    except InputError as error:
        yield from (str(problem) for problem in error.problems)
        return
    if rows != count:
        yield f"{name}: {rows} rows — expected {count}"


def _check_messages(record: RunRecord) -> Iterator[str]:
    """Compare the rows of telemetry with those that the manifest declares of each message."""
    if not record.keeps(FOLDER):
        return
    declared = record.manifest.get("messages") or {}
    try:
        counts = count_messages(record.tables)
    except InputError as error:
        yield from (str(problem) for problem in error.problems)
        return
    for message in sorted({*declared, *counts}):
        if counts.get(message) != declared.get(message):
            yield f"{FOLDER}/{message}: {counts.get(message, 0)} rows — expected {declared.get(message, 0)}"


def _frames_digest(record: RunRecord) -> str:
    digests, payloads = Digests(), PayloadDeduplicator(_WINDOW_BYTES)
    rows = 0
    for table in record.tables.frames_with_payloads():
        if table.num_rows:
            rows += table.num_rows
            digests.add_frames(_frame_words(table, payloads))
            payloads.take_new()
    expected = record.rows("frames")
    if rows != expected:
        raise InputError.one(str(record.path), "payloads", f"those of {rows} frames", f"those of {expected}")
    return digests.frames


def _frame_words(table: pa.Table, payloads: PayloadDeduplicator) -> Words:
    """The digest's words of frames, as `write.frame_encoder` lays them out."""
    words = np.zeros((table.num_rows, 10), dtype=np.uint64)
    words[:, 0] = _hash_texts(pc.binary_join_element_wise(*(_text(table, name) for name in _FLOW), "\n"))
    words[:, 1] = table.column("serial").to_numpy().view(np.uint64)
    words[:, 2] = table.column("sent_ns").to_numpy().view(np.uint64)
    arrived = table.column("arrived_ns")
    arrived_ns = pc.fill_null(arrived, 0).to_numpy().view(np.uint64)
    words[:, 3] = np.where(pc.is_null(arrived).to_numpy(), np.uint64(_NEVER), arrived_ns)
    words[:, 4] = _hash_texts(_text(table, "fate"))
    _, words[:, 5:7] = payloads.assign_ids(Payloads.of(table.column("payload").to_pylist()))
    parents = _text(table, "parent")
    has_parent = pc.is_valid(parents).to_numpy()
    words[:, 8] = np.uint64(_NEVER)
    if has_parent.any():
        halves = pc.split_pattern(pc.drop_null(parents), "|", max_splits=1, reverse=True)
        origins = pc.replace_substring(pc.list_element(halves, 0), "|", "\n")
        words[has_parent, 7] = _hash_texts(origins)
        words[has_parent, 8] = pc.cast(pc.list_element(halves, 1), pa.int64()).to_numpy().view(np.uint64)
    causes = table.column("causes")
    for row in np.flatnonzero(pc.fill_null(pc.list_value_length(causes), 0).to_numpy()).tolist():
        words[row, 9] = hash64("\n".join(causes[row].as_py()))
    return words


def _text(table: pa.Table, name: str) -> pa.ChunkedArray:
    return table.column(name).cast(pa.string())


def _hash_texts(texts: pa.ChunkedArray) -> NDArray[np.uint64]:
    """`hash64` of each text; few are distinct."""
    encoded = pc.dictionary_encode(texts)
    if isinstance(encoded, pa.ChunkedArray):
        encoded = encoded.combine_chunks()
    encoded = encoded.chunk(0) if isinstance(encoded, pa.ChunkedArray) else encoded
    hashes = np.array([hash64(text) for text in encoded.dictionary.to_pylist()], dtype=np.uint64)
    hashed: NDArray[np.uint64] = hashes[encoded.indices.to_numpy()]
    return hashed


def _truth_digest(record: RunRecord) -> str:
    digests = Digests()
    for batch in record.batches("truth"):
        if batch.num_rows:
            digests.add_truth(truth_words(split_ticks(batch)))
    return digests.truth


def _events_digest(record: RunRecord) -> str:
    digests = Digests()
    for batch in record.batches("events", ["about", "time_ns", "source", "kind"]):
        for row in zip(*(column.to_pylist() for column in batch.columns), strict=True):
            if row[3].startswith("event."):
                digests.add_event(*row)
    return digests.events
