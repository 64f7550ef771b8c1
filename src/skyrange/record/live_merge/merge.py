"""Merging of the records of a live run's nodes into one record, as if one kernel had recorded the run.

Frames that crossed between nodes are matched first and spooled separately. Then the recorder of the whole run writes
everything in order of time, under its true ids. Memory is bounded: rows are read in batches, several times.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from skyrange.agent.frames import Fate, Frame
from skyrange.agent.messages import Note
from skyrange.agent.monitors import Alert
from skyrange.agent.verdicts import Label
from skyrange.core.errors import SkyrangeError
from skyrange.core.ids import FrameId
from skyrange.record.crossings import ROWS, Crossings, Spans, borders
from skyrange.record.order import in_order, interleaved
from skyrange.record.parts import INCOMING, Part
from skyrange.record.recorder import Recorder
from skyrange.record.renames import Renames
from skyrange.record.spool import SPOOL, Spool, read_spool

_CROSSED = "crossed"
"""The spool stream for frames that crossed between nodes; it is deleted before the record is closed."""

_FRAME_TIES = ("link", "direction", "sender", "serial")


def merge(
    parts: Sequence[Path],
    into: Path,
    header: Mapping[str, Any],
    *,
    status: str = "complete",
    extra: Mapping[str, Any] | None = None,
    truth_hz: float = 10.0,
    sensors_hz: float = 2.0,
    files: Iterable[tuple[str, Path]] = (),
) -> None:
    """Write the record of the whole run to `into`, a folder that does not exist or that holds nothing but `.parts`.

    This is for parts that a killed supervisor left behind; a running supervisor calls `gather` itself.

    `parts` are folders that a `Recorder` wrote, closed or not. The manifest of each has an entry `node` with its
    `name`, the `endpoints` that ran there, the `offset_ns` to add to its times, and optionally `until_ns`, the time on
    its own clock until which it recorded. Without `until_ns`, a complete part lasted until the run's end and any other
    until its last row. `files` are copied into the folder under their names. `header` is that of `Recorder.open` and
    includes the run's `links`. The rates are those at which the parts were recorded.

    The manifest gets `nodes`, an entry for each part including unreadable ones, and `crossings`, the counts of
    matched and unmatched frames. `extra` overrides these entries. Raises `InputError` as `Recorder.open` does, and
    `ComponentError` if writing fails; the parts are not changed.
    """
    recorder = Recorder.open(into, header, truth_hz=truth_hz, sensors_hz=sensors_hz)
    try:
        for name, path in files:
            recorder.keep(name, path)
        found = gather(parts, recorder, header)
    except SkyrangeError:
        recorder.close("failed", extra)
        raise
    recorder.close(status, {**found, **(extra or {})})


def gather(folders: Sequence[Path], recorder: Recorder, header: Mapping[str, Any]) -> dict[str, Any]:
    """Write the contents of the parts in `folders` to an open recorder that has observed nothing else.

    Returns the manifest entries `nodes` and `crossings` for `Recorder.close`. Otherwise like `merge`.
    """
    lanes = borders(header)
    parts = [Part.open(number, folder) for number, folder in enumerate(folders)]
    for part in parts:
        part.survey({lane: (border.src, border.dst) for lane, border in lanes.items()})
    entries = [part.manifest_entry() for part in parts]
    parts = [replace(part, number=number) for number, part in enumerate(sorted(parts, key=_start_and_number))]
    _continue_serials(parts)
    crossings = Crossings(parts, lanes, Spans(parts))
    for part in parts:
        for name, path in part.files():
            if not (recorder.path / name).exists():
                recorder.keep(name, path)
    spool = Spool(recorder.path)
    for batch in crossings.rows():
        if batch.num_rows:
            spool.append(_CROSSED, batch)
    spool.end_segment()
    renames = [part.renames for part in parts]
    for frame in _frames(parts, recorder.path, renames):
        recorder.on_frame(frame)
    for table in ("decisions", "events"):
        for now, source, note in _notes(parts, table, renames):
            recorder.on_note(now, source, note)
    for label in _labels(parts, renames):
        recorder.on_label(label)
    for now, detector, alert in _alerts(parts):
        recorder.on_alert(now, detector, alert)
    for table in ("truth", "sensors", "receptions"):
        for rows in _interleaved(parts, table):
            named = _with_true_ids(rows, renames) if table == "receptions" else rows
            for batch in named.drop_columns(["part", "row"]).combine_chunks().to_batches():
                recorder.on_rows(table, batch)
    (recorder.path / SPOOL / f"{_CROSSED}-0000.arrows").unlink(missing_ok=True)
    return {"nodes": entries, "crossings": crossings.counts}


def _start_and_number(part: Part) -> tuple[int, int]:
    return part.first_ns, part.number


def _continue_serials(parts: Sequence[Part]) -> None:
    """Let the serials of a restarted node continue where those of its earlier part ended."""
    heights: dict[tuple[str, str, str], int] = {}
    for part in parts:
        part.shifts = {flow: heights[flow] for flow in part.heights if flow in heights}
        for flow, height in part.heights.items():
            heights[flow] = heights.get(flow, 0) + height
        incoming = {lane: source for lane, (how, source) in part.lanes.items() if how == INCOMING}
        part.renames = Renames(incoming, part.shifts)


def _frames(parts: Sequence[Part], folder: Path, renames: Sequence[Renames]) -> Iterator[Frame]:
    """All frames in order of sending, with their true ids."""

    def crossed() -> Iterator[pa.Table]:
        return (pa.Table.from_batches([batch]) for batch in read_spool(folder, _CROSSED))

    streams = [_select_columns(part.frames(crossing=False)) for part in parts]
    streams.append(in_order(crossed, "sent_ns", _FRAME_TIES))
    for table in interleaved(streams, "sent_ns", _FRAME_TIES):
        columns = [table.column(name).to_pylist() for name in ROWS.names]
        for row in zip(*columns, strict=True):
            link, direction, sender, serial, src, dst, sent, arrived, fate, parent, causes, payload, part = row
            names = renames[part]
            frame = Frame(
                link,
                direction,
                sender,
                serial,
                src,
                dst,
                sent,
                payload,
                None if parent is None else names.text(parent),
                tuple(map(names.text, causes)) if causes else (),
            )
            frame.fate = Fate(fate)
            if arrived is not None:
                frame.arrived_ns = arrived
            yield frame


def _select_columns(tables: Iterator[pa.Table]) -> Iterator[pa.Table]:
    return (table.select(ROWS.names).cast(ROWS) for table in tables)


def _interleaved(parts: Sequence[Part], table: str) -> Iterator[pa.Table]:
    """A table's rows in order of time; rows of one time keep the order of their part."""
    streams = [part.read(table) for part in parts]
    if table in ("decisions", "events"):
        return interleaved(streams, "time_ns", ("source", "part", "row"))
    return interleaved(streams, "at_ns" if table == "labels" else "time_ns", ("part", "row"))


def _notes(parts: Sequence[Part], table: str, renames: Sequence[Renames]) -> Iterator[tuple[int, str, Note]]:
    for rows in _interleaved(parts, table):
        for row in rows.to_pylist():
            causes = tuple(map(renames[row["part"]].text, row["causes"] or ()))
            yield row["time_ns"], row["source"], Note(row["kind"], row["about"], json.loads(row["data"]), causes)


def _labels(parts: Sequence[Part], renames: Sequence[Renames]) -> Iterator[Label]:
    for rows in _interleaved(parts, "labels"):
        for row in rows.to_pylist():
            names = renames[row["part"]]
            child = None if row["child"] is None else names.text(row["child"])
            acted_on = names.text(row["frame"])
            yield Label(row["at_ns"], row["attack"], row["actor"], row["action"], acted_on, child, row["until_ns"])


def _alerts(parts: Sequence[Part]) -> Iterator[tuple[int, str, Alert]]:
    for rows in _interleaved(parts, "alerts"):
        for row in rows.to_pylist():
            alert = Alert(row["at_ns"], row["subject"], row["kind"], row["score"], json.loads(row["data"]))
            yield row["time_ns"], row["detector"], alert


def _with_true_ids(rows: pa.Table, renames: Sequence[Renames]) -> pa.Table:
    """Receptions with the true senders and serials of the received frames."""
    columns = [rows.column(name).to_pylist() for name in ("part", *_FRAME_TIES)]
    known: dict[tuple[Any, ...], FrameId] = {}
    true = []
    for key in zip(*columns, strict=True):
        id_ = known.get(key)
        if id_ is None:
            id_ = known[key] = renames[key[0]].of(FrameId(*key[1:]))
        true.append(id_)
    for name in ("sender", "serial"):
        place = rows.column_names.index(name)
        rows = rows.set_column(place, rows.field(place), [[getattr(id_, name) for id_ in true]])
    return rows
