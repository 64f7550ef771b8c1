"""How do the parts that the nodes of a live run recorded become one record, as if one kernel had recorded it?

The frames that crossed between nodes are matched first and set aside; then everything is written in order of time,
under its true ids, by the recorder of the whole. Memory is bounded: rows are read in batches, several times.
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
"""The spooled stream of frames that crossed between nodes, until the record is closed."""

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
    """Make the record of the whole run in `into`, a folder that does not exist or holds nothing but `.parts`.

    For parts that a supervisor left behind when it was killed; one that lives gathers them itself.

    `parts` are folders that `Recorder` wrote, closed or not; each one's manifest has `node`: its `name`, the
    `endpoints` that lived there, the `offset_ns` to add to its times, and if it says so `until_ns`, on its own clock,
    the time until which it recorded (else a complete part lasted until the run's end, another until its last row).
    `files` are put into the folder too, each under its name.
    `header` is as `Recorder.open` takes it, with the run's `links`; rates are what the parts recorded at. The manifest
    gets `nodes`, an entry for each part, also of one that is missing, and `crossings`, how many frames that went
    between nodes were found again; `extra` goes in over that. `InputError` as `Recorder.open`, `ComponentError` where
    the disk refuses: the parts stay as they are.
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
    """Write what the parts in `folders` hold to a recorder that is open and told nothing else.

    Returns the manifest's `nodes` and `crossings`, as `Recorder.close` takes them. Otherwise as `merge`.
    """
    lanes = borders(header)
    parts = [Part.open(number, folder) for number, folder in enumerate(folders)]
    for part in parts:
        part.survey({lane: (border.src, border.dst) for lane, border in lanes.items()})
    said = [part.said() for part in parts]
    parts = [replace(part, number=number) for number, part in enumerate(sorted(parts, key=_when))]
    _count_on(parts)
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
            named = _renamed(rows, renames) if table == "receptions" else rows
            for batch in named.drop_columns(["part", "row"]).combine_chunks().to_batches():
                recorder.on_rows(table, batch)
    (recorder.path / SPOOL / f"{_CROSSED}-0000.arrows").unlink(missing_ok=True)
    return {"nodes": said, "crossings": crossings.counts}


def _when(part: Part) -> tuple[int, int]:
    return part.first_ns, part.number


def _count_on(parts: Sequence[Part]) -> None:
    """Senders of a node that was started anew count on from where their earlier part's ended."""
    heights: dict[tuple[str, str, str], int] = {}
    for part in parts:
        part.shifts = {flow: heights[flow] for flow in part.heights if flow in heights}
        for flow, height in part.heights.items():
            heights[flow] = heights.get(flow, 0) + height
        incoming = {lane: source for lane, (how, source) in part.lanes.items() if how == INCOMING}
        part.renames = Renames(incoming, part.shifts)


def _frames(parts: Sequence[Part], folder: Path, renames: Sequence[Renames]) -> Iterator[Frame]:
    """All frames in order of sending, under their true ids."""

    def crossed() -> Iterator[pa.Table]:
        return (pa.Table.from_batches([batch]) for batch in read_spool(folder, _CROSSED))

    streams = [_plain(part.frames(crossing=False)) for part in parts]
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


def _plain(tables: Iterator[pa.Table]) -> Iterator[pa.Table]:
    return (table.select(ROWS.names).cast(ROWS) for table in tables)


def _interleaved(parts: Sequence[Part], table: str) -> Iterator[pa.Table]:
    """A table's rows in order of time; rows of one time stay as their part had them."""
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


def _renamed(rows: pa.Table, renames: Sequence[Renames]) -> pa.Table:
    """Receptions with the true senders and serials of what was received."""
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
