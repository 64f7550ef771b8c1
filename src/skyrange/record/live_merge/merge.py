"""Merging of the records of a live run's nodes into one record, as if one kernel had recorded the run.

Frames that crossed between nodes are matched first and spooled separately. Then the recorder of the whole run writes
everything in order of time, under its true ids. Memory is bounded: rows are read in batches, several times.

The same recovers the record of a range whose supervisor was killed, from the parts that it left behind.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from skyrange.contracts.alerts import Alert
from skyrange.contracts.frames import Fate, Frame, end_journey
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.errors import InputError, SkyrangeError
from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER
from skyrange.record.folder import PARTS
from skyrange.record.live_merge.crossing_frames import ROWS, CrossingMatcher, RecordingSpans, direction_specs
from skyrange.record.live_merge.frame_matching import FrameIdMap
from skyrange.record.live_merge.node_record import INCOMING, NodeRecord, attached_files
from skyrange.record.manifest import MANIFEST, RUNNING, read_manifest
from skyrange.record.notes import parse_details
from skyrange.record.read.time_order import merge_sorted, sort_by_time
from skyrange.record.spool import SPOOL, Spool, read_spool
from skyrange.record.write.recorder import Recorder

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
    features_hz: float = 1.0,
    csv: bool = False,
    files: Iterable[tuple[str, Path]] = (),
) -> None:
    """Write the record of the whole run to `into`, a folder that does not exist or that holds nothing but `.parts`.

    This is for parts that a killed supervisor left behind; a running supervisor calls `gather` itself.

    `parts` are folders that a `Recorder` wrote, closed or not. The manifest of each has an entry `node` with its
    `name`, the `endpoints` that ran there, the `offset_ns` to add to its times, and optionally `until_ns`, the time on
    its own clock until which it recorded. Without `until_ns`, a complete part lasted until the run's end and any other
    until its last row. `files` are copied into the folder under their names. `header` is that of `Recorder.open` and
    includes the run's `links`. The rates are those at which the parts were recorded; `features_hz` and `csv` as in
    `Recorder.open`.

    The manifest gets `nodes`, an entry for each part including unreadable ones, and `crossings`, the counts of
    matched and unmatched frames. `extra` overrides these entries. Raises `InputError` as `Recorder.open` does, and
    `ComponentError` if writing fails; the parts are not changed.
    """
    recorder = Recorder.open(into, header, truth_hz=truth_hz, sensors_hz=sensors_hz, features_hz=features_hz, csv=csv)
    try:
        for name, path in files:
            recorder.keep_file(name, path)
        gathered = gather(parts, recorder, header)
    except SkyrangeError:
        recorder.close("failed", extra)
        raise
    recorder.close(status, {**gathered, **(extra or {})})


def gather(folders: Sequence[Path], recorder: Recorder, header: Mapping[str, Any]) -> dict[str, Any]:
    """Write the contents of the parts in `folders` to an open recorder that has observed nothing else.

    Returns the manifest entries `nodes` and `crossings` for `Recorder.close`. Otherwise like `merge`.
    """
    directions = direction_specs(header)
    parts = [NodeRecord.open(number, folder) for number, folder in enumerate(folders)]
    for part in parts:
        part.scan({direction: (spec.src, spec.dst) for direction, spec in directions.items()})
    entries = [part.manifest_entry() for part in parts]
    parts = [replace(part, number=number) for number, part in enumerate(sorted(parts, key=_start_and_number))]
    _continue_serials(parts)
    crossings = CrossingMatcher(parts, directions, RecordingSpans(parts))
    for part in parts:
        for name, path in part.files():
            if not (recorder.path / name).exists():
                recorder.keep_file(name, path)
    spool = Spool(recorder.path)
    for batch in crossings.rows():
        if batch.num_rows:
            spool.append(_CROSSED, batch)
    spool.end_segment()
    id_maps = [part.id_map for part in parts]
    for frame in _frames(parts, recorder.path, id_maps):
        recorder.on_frame(frame)
    for table in ("decisions", "events"):
        for now, source, note in _notes(parts, table, id_maps):
            recorder.on_note(now, source, note)
    for label in _labels(parts, id_maps):
        recorder.on_label(label)
    for now, detector, alert in _alerts(parts):
        recorder.on_alert(now, detector, alert)
    for table in ("truth", "sensors", "received_sensors", "receptions"):
        for rows in _interleaved(parts, table):
            named = _with_true_ids(rows, id_maps) if table == "receptions" else rows
            for batch in named.drop_columns(["part", "row"]).combine_chunks().to_batches():
                recorder.on_rows(table, batch)
    (recorder.path / SPOOL / f"{_CROSSED}-0000.arrows").unlink(missing_ok=True)
    return {"nodes": entries, "crossings": crossings.counts}


def _start_and_number(part: NodeRecord) -> tuple[int, int]:
    return part.first_ns, part.number


def _continue_serials(parts: Sequence[NodeRecord]) -> None:
    """Let the serials of a restarted node continue where those of its earlier part ended."""
    next_serials: dict[tuple[str, str, str], int] = {}
    for part in parts:
        part.serial_offsets = {flow: next_serials[flow] for flow in part.next_serials if flow in next_serials}
        for flow, next_serial in part.next_serials.items():
            next_serials[flow] = next_serials.get(flow, 0) + next_serial
        incoming = {direction: source for direction, (how, source) in part.directions.items() if how == INCOMING}
        part.id_map = FrameIdMap(incoming, part.serial_offsets)


def _frames(parts: Sequence[NodeRecord], folder: Path, id_maps: Sequence[FrameIdMap]) -> Iterator[Frame]:
    """All frames in order of sending, with their true ids."""

    def crossed() -> Iterator[pa.Table]:
        return (pa.Table.from_batches([batch]) for batch in read_spool(folder, _CROSSED))

    streams = [_select_columns(part.frames(crossing=False)) for part in parts]
    streams.append(sort_by_time(crossed, "sent_ns", _FRAME_TIES))
    for table in merge_sorted(streams, "sent_ns", _FRAME_TIES):
        columns = [table.column(name).to_pylist() for name in ROWS.names]
        for row in zip(*columns, strict=True):
            link, direction, sender, serial, src, dst, sent, arrived, fate, parent, causes, payload, part = row
            names = id_maps[part]
            frame = Frame(
                link,
                direction,
                sender,
                serial,
                src,
                dst,
                sent_ns=sent,
                payload=payload,
                parent=None if parent is None else names.resolve_text(parent),
                causes=tuple(map(names.resolve_text, causes)) if causes else (),
            )
            end_journey(frame, Fate(fate), NEVER if arrived is None else arrived)
            yield frame


def _select_columns(tables: Iterator[pa.Table]) -> Iterator[pa.Table]:
    return (table.select(ROWS.names).cast(ROWS) for table in tables)


def _interleaved(parts: Sequence[NodeRecord], table: str) -> Iterator[pa.Table]:
    """A table's rows in order of time; rows of one time keep the order of their part."""
    streams = [part.read(table) for part in parts]
    if table in ("decisions", "events"):
        return merge_sorted(streams, "time_ns", ("source", "part", "row"))
    return merge_sorted(streams, "at_ns" if table == "labels" else "time_ns", ("part", "row"))


def _notes(parts: Sequence[NodeRecord], table: str, id_maps: Sequence[FrameIdMap]) -> Iterator[tuple[int, str, Note]]:
    for rows in _interleaved(parts, table):
        for row in rows.to_pylist():
            causes = tuple(map(id_maps[row["part"]].resolve_text, row["causes"] or ()))
            yield row["time_ns"], row["source"], Note(row["kind"], row["about"], parse_details(row["data"]), causes)


def _labels(parts: Sequence[NodeRecord], id_maps: Sequence[FrameIdMap]) -> Iterator[Label]:
    for rows in _interleaved(parts, "labels"):
        for row in rows.to_pylist():
            names = id_maps[row["part"]]
            child = None if row["child"] is None else names.resolve_text(row["child"])
            acted_on, action = names.resolve_text(row["frame"]), row["action"]
            yield Label(
                row["at_ns"], row["attack"], row["actor"], action, acted_on, child, row["until_ns"], row["benign"],
                row["fault"], row["harmless_intrusion"],
            )  # fmt: skip


def _alerts(parts: Sequence[NodeRecord]) -> Iterator[tuple[int, str, Alert]]:
    for rows in _interleaved(parts, "alerts"):
        for row in rows.to_pylist():
            alert = Alert(row["at_ns"], row["subject"], row["kind"], row["score"], parse_details(row["data"]))
            yield row["time_ns"], row["detector"], alert


def _with_true_ids(rows: pa.Table, id_maps: Sequence[FrameIdMap]) -> pa.Table:
    """Receptions with the true senders and serials of the received frames."""
    columns = [rows.column(name).to_pylist() for name in ("part", *_FRAME_TIES)]
    known: dict[tuple[Any, ...], FrameId] = {}
    true = []
    for key in zip(*columns, strict=True):
        id_ = known.get(key)
        if id_ is None:
            id_ = known[key] = id_maps[key[0]].resolve(FrameId(*key[1:]))
        true.append(id_)
    for name in ("sender", "serial"):
        place = rows.column_names.index(name)
        rows = rows.set_column(place, rows.field(place), [[getattr(id_, name) for id_ in true]])
    return rows


ACTIVE_S: Final = 5.0
"""A part that was written within this time may still be in use: recorders write every second."""
_OF_THE_WHOLE: Final = {"format", "status", "skyrange", "versions", "platform", "record", "counts", "error", "spooled"}
"""Entries that the new record's manifest sets itself."""


def describe_parts(run: Path, status: str) -> str:
    """What a reader of a live run's folder should know of parts that are not merged; "" where there are none.

    `status` is that of its manifest.
    """
    parts = _find_parts(run)
    if not parts:
        return ""
    if status == RUNNING and _is_written_to(run, parts):
        return "the range is flying, or its records are being merged: what there is of them is not whole yet"
    return f"the records of the range's processes are not merged: `skyrange merge {run}` merges them"


def _find_parts(run: Path) -> list[Path]:
    return sorted(path.parent for path in (run / PARTS).glob(f"*/{MANIFEST}"))


def _is_written_to(run: Path, parts: Sequence[Path]) -> bool:
    """Whether parts are recorded, or merged into the spool of the run."""
    times_s = [_changed_s(path) for folder in (*parts, run / SPOOL) for path in (folder, *folder.rglob("*"))]
    return time.time() - max(times_s, default=0.0) < ACTIVE_S


def _changed_s(path: Path) -> float:
    """When a file was changed; long ago if it has been removed meanwhile."""
    try:
        return path.stat().st_mtime
    except FileNotFoundError:
        return 0.0


def recover_run(run: Path, out: Path) -> None:
    """Merge the parts in a live run's folder `run` into one record in `out`, a folder that does not exist or is empty.

    The parts are not changed. The status of the record is `failed`, because the range did not end by itself. Raises
    `InputError` if `run` has no parts or if they are still being written.
    """
    manifest = read_manifest(run)
    parts = _find_parts(run)
    if not parts:
        hint = "A live range leaves parts behind if it was killed, or if the disk was too full to merge them."
        raise InputError.one("merge", str(run), f"no parts in {PARTS}", "the folder of a live range with parts", hint)
    if manifest["status"] == RUNNING and _is_written_to(run, parts):
        raise InputError.one("merge", str(run), "still written to", "a range that has ended", "Stop it with Ctrl-C.")
    header: dict[str, Any] = {key: value for key, value in manifest.items() if key not in _OF_THE_WHOLE}
    why = {"error": manifest.get("error", "the supervisor was killed")}
    settings = {key: value for key, value in manifest["record"].items() if key != "level"}  # which is full
    merge(parts, out, header, status="failed", extra=why, files=attached_files(run), **settings)
