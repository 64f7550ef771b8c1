"""Observations of a run that wait to be written, and the rows of the tables that they become.

The level of the record decides which of them are kept. All of them count for the digests.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol, runtime_checkable

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.codec.remote_id.link_payload import Transport
from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import ReceivedSensors, World
from skyrange.contracts.frames import Frame, FrameBlock
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.medium import ReceptionOutcome, Receptions
from skyrange.contracts.verdicts import Label
from skyrange.core.time import Time
from skyrange.optics.scanner import ScanTruth
from skyrange.record.digests import Words
from skyrange.record.notes import (
    CRASH,
    OUTCOME,
    AlertRow,
    NoteRow,
    alert_batch,
    alert_row,
    label_batch,
    note_batch,
    note_row,
    outcome,
    table_of,
)
from skyrange.record.write.recording_state import RecordingState
from skyrange.record.write.rows.frame_encoder import GatheredFrames
from skyrange.record.write.rows.scans import scan_batch
from skyrange.record.write.rows.ticks import (
    SensorTick,
    TruthTick,
    received_tick,
    sensor_batch,
    sensor_tick,
    split_ticks,
    truth_batch,
    truth_tick,
    truth_words,
)

_OUTCOMES: Final = pa.array([outcome.name.lower() for outcome in ReceptionOutcome], pa.string())
_TRANSPORTS: Final = pa.array(["other", *(transport.name.lower() for transport in Transport)], pa.string())
"""Names by number; `Transport` counts from 1."""


class ReceptionSource(Protocol):
    """Source of receptions: the owner of a radio medium."""

    def drain_receptions(self) -> Receptions | None:
        """Receptions since the last call, or `None`."""
        ...


@runtime_checkable
class ForeignSource(Protocol):
    """Source of receptions of frames that other processes of the run record."""

    def drain_foreign(self) -> pa.Table | None:
        """Those frames since the last call: link, direction, sender, serial, times and payload as in `frames`."""
        ...


def reception_batch(receptions: Receptions) -> pa.RecordBatch:
    """Rows of the `receptions` table, in the given order."""
    rows = receptions.rows
    place = rows.place_enu_m.astype(np.float32)
    named = [pa.array([name[part] for name in receptions.names], pa.string()) for part in range(3)]
    return pa.RecordBatch.from_arrays(
        [
            pa.array(rows.time_ns),
            *(_dictionary_array(rows.number, names) for names in named),
            pa.array(rows.serial),
            _dictionary_array(rows.radio, pa.array(receptions.radios, pa.string())),
            *(pa.array(place[:, axis]) for axis in range(3)),
            _dictionary_array(rows.transport, _TRANSPORTS),
            pa.array(rows.channel),
            pa.array(rows.rssi_dbm.astype(np.float32)),
            pa.array(rows.snir_db.astype(np.float32)),
            _dictionary_array(rows.outcome, _OUTCOMES),
        ],
        names=[
            "time_ns", "link", "direction", "sender", "serial", "receiver", "east_m", "north_m", "up_m", "transport",
            "channel", "rssi_dbm", "snir_db", "outcome",
        ],
    )  # fmt: skip


def _dictionary_array(numbers: NDArray[np.int64], names: pa.Array) -> pa.DictionaryArray:
    """A dictionary array of `names[numbers]`. Several numbers may have one name, so the dictionary is made unique."""
    unique, place = np.unique(np.array(names.to_pylist(), dtype=object), return_inverse=True)
    codes = place[numbers].astype(np.int32)
    return pa.DictionaryArray.from_arrays(pa.array(codes), pa.array(unique.tolist(), pa.string()))


def count_payload_bytes(block: FrameBlock) -> int:
    """Bytes of the payloads of all frames of a block."""
    sizes = block.payloads.sizes
    return int(sizes.sum() if block.rows is None else sizes[block.rows].sum())


class WaitingRows:
    """Observations since the last write. Methods `add_…` take them; methods `write_…` hand their rows to `append`.

    Frames are kept by reference until then, because they do not change after they were observed.
    """

    def __init__(self, state: RecordingState, append: Callable[[str, pa.RecordBatch], None]) -> None:
        """`append` writes rows of a table, which it names."""
        self._state = state
        self._append = append
        self._frames: list[Frame | FrameBlock] = []
        self.single_frames = 0
        self.block_frames = 0
        """Frames of blocks."""
        self.frame_bytes = 0
        """Payloads of frames, single or of blocks."""
        self._notes: dict[str, list[NoteRow]] = {"decisions": [], "events": []}
        self._labels: list[Label] = []
        self._alerts: list[AlertRow] = []
        self._truth: list[TruthTick] = []
        self._sensors: list[SensorTick] = []
        self._received: list[SensorTick] = []
        self._tick_bytes = 0

    # ---------------------------------------------------------------- observations

    def add_frame(self, frame: Frame) -> None:
        """Take a frame."""
        self._frames.append(frame)
        self.single_frames += 1
        self.frame_bytes += len(frame.payload)

    def add_block(self, block: FrameBlock) -> None:
        """Take a block of frames."""
        self._frames.append(block)
        self.block_frames += len(block)
        self.frame_bytes += count_payload_bytes(block)

    def add_note(self, now: Time, source: str, note: Note) -> None:
        """Take a decision or an event."""
        self._notes[table_of(note.kind)].append(note_row(now, source, note))
        state = self._state
        if note.kind.startswith("event."):
            state.digests.add_event(note.about, now, source, note.kind)
            if note.kind == OUTCOME:
                state.outcomes[note.about] = outcome(now, note.data)
            elif note.kind == CRASH:
                state.crashes.setdefault(note.about, now)
        state.last_ns = max(state.last_ns, now)

    def add_label(self, label: Label) -> int:
        """Take a label; returns how many wait."""
        self._labels.append(label)
        return len(self._labels)

    def add_alert(self, now: Time, detector: str, alert: Alert) -> int:
        """Take an alert; returns how many wait."""
        self._alerts.append(alert_row(now, detector, alert))
        return len(self._alerts)

    def add_tick(self, now: Time, world: World, received: ReceivedSensors | None) -> int:
        """Take the truth and the sensors at the end of a tick if they are due; returns the bytes of those that wait.

        `received` are the readings that autopilots received, of the aircraft that have sensor faults.
        """
        state = self._state
        state.last_ns = max(state.last_ns, now)
        vehicles = tuple(world.vehicles)
        if now >= state.truth_due and vehicles:
            state.truth_due = now - now % state.truth_ns + state.truth_ns
            tick = truth_tick(now, world)
            self._truth.append(tick)
            self._tick_bytes += len(vehicles) * 8 * (len(tick.columns) + 2)
        if now >= state.sensors_due and vehicles:
            state.sensors_due = now - now % state.sensors_ns + state.sensors_ns
            self._sensors.append(sensor_tick(now, world))
            self._tick_bytes += self._sensors[-1].values.nbytes
            altered = None if received is None else received_tick(now, world, received)
            if altered is not None and altered.vehicles:
                self._received.append(altered)
                self._tick_bytes += altered.values.nbytes
        return self._tick_bytes

    def clear(self) -> None:
        """Drop what waits."""
        self._frames.clear()
        self.single_frames = self.block_frames = self.frame_bytes = 0
        for rows in self._notes.values():
            rows.clear()
        self._labels.clear()
        self._alerts.clear()
        self._truth.clear()
        self._sensors.clear()
        self._received.clear()
        self._tick_bytes = 0

    # ---------------------------------------------------------------- rows

    def write_frames(self) -> None:
        """Write the frames, or count them for the table `features`."""
        frames = self.take_frames()
        if not frames:
            return
        encoder = self._state.encoder
        gathered = encoder.gather(frames)
        words = encoder.words(gathered)
        if self._state.keeps("frames"):
            self._count(gathered, words)
            payloads = encoder.take_payloads()
            if payloads.num_rows:  # first, so that no frame's row is without its payload
                self._append("payloads", payloads)
            self._append("frames", encoder.table(gathered))
        elif self._state.study_rows is None:
            encoder.forget_payloads()
            self.count_frames(gathered, words, None)
        else:
            self.count_frames(gathered, words, encoder.take_payloads())

    def take_frames(self) -> list[Frame | FrameBlock]:
        """The frames that wait, for `count_frames`: they wait no longer."""
        frames = self._frames
        self._frames = []
        self.single_frames = self.block_frames = self.frame_bytes = 0
        return frames

    def keep_frames(self, gathered: GatheredFrames, words: Words, payloads: pa.RecordBatch) -> None:
        """Keep frames, with the payloads that are new to the encoder among them; some may be other runs'."""
        self._count(gathered, words)
        self._append("payloads", payloads)
        self._append("frames", self._state.encoder.table(gathered))

    def count_frames(self, gathered: GatheredFrames, words: Words, payloads: pa.RecordBatch | None) -> None:
        """Count frames at a level that does not keep them: for the digest, which takes their `words`, and in
        `features`, with the payloads that are new to the encoder, or without.
        """
        self._count(gathered, words)
        state = self._state
        state.leave_out("frames", gathered.rows)
        if state.study_rows is not None and payloads is not None:
            state.study_rows.add_frames(state.encoder, gathered, payloads)
            if state.study_rows.is_full:
                self.write_study_rows()

    def _count(self, gathered: GatheredFrames, words: Words) -> None:
        self._state.digests.add_frames(words)
        self._state.last_ns = max(self._state.last_ns, gathered.last_ns)

    def keeps(self, table: str) -> bool:
        """Whether the level keeps the rows of a table."""
        return self._state.keeps(table)

    def write_truth(self, words: Words, batch: pa.RecordBatch | None, last_ns: Time) -> None:
        """Count truth up to `last_ns` for the digest, which takes its `words`, and write its rows if they are kept."""
        self._state.digests.add_truth(words)
        self._state.last_ns = max(self._state.last_ns, last_ns)
        if batch is None:
            self._state.leave_out("truth", len(words))
        else:
            self._append("truth", batch)

    def write_sensors(self, table: str, batch: pa.RecordBatch, last_ns: Time) -> None:
        """Write rows of `sensors` or `received_sensors`."""
        self._state.last_ns = max(self._state.last_ns, last_ns)
        self._append(table, batch)

    def write_ticks(self) -> None:
        """Write truth and sensors."""
        if self._truth:
            self._state.digests.add_truth(truth_words(self._truth))
            if self._state.keeps("truth"):
                self._append("truth", truth_batch(self._truth))
            else:
                self._state.leave_out("truth", sum(len(tick.vehicles) for tick in self._truth))
        if self._sensors:
            self._append("sensors", sensor_batch(self._sensors))
        if self._received:
            self._append("received_sensors", sensor_batch(self._received))

    def write_receptions(self, receptions: Receptions) -> None:
        """Write receptions of frames that were written before, or make observations of them."""
        state = self._state
        if state.keeps("receptions"):
            self._append("receptions", reception_batch(receptions))
            return
        state.leave_out("receptions", len(receptions.rows.time_ns))
        if state.study_rows is not None:
            state.study_rows.add_receptions(reception_batch(receptions))

    def write_scans(self, scans: Sequence[ScanTruth]) -> None:
        """Write the truth of scans."""
        if not scans:
            return
        if self._state.keeps("scans"):
            self._append("scans", scan_batch(scans))
        else:
            self._state.leave_out("scans", len(scans))

    def write_notes(self) -> None:
        """Write decisions, events, labels and alerts."""
        for table, rows in self._notes.items():
            if rows:
                self._append(table, note_batch(table, rows))
        if self._labels and self._state.keeps("labels"):
            self._append("labels", label_batch(self._labels))
        elif self._labels:
            self._state.leave_out("labels", len(self._labels))
        if self._alerts:
            self._append("alerts", alert_batch(self._alerts))

    def write_study_rows(self, *, last: bool = False) -> None:
        """Write the rows of the level `study` that are whole, and with `last` all."""
        if self._state.study_rows is not None:
            for table, batch in self._state.study_rows.take(last=last):
                self._append(table, batch)

    def write_rows(self, table: str, batch: pa.RecordBatch) -> None:
        """Write rows of truth, sensors or receptions that another recorder has made."""
        state = self._state
        if table == "truth":
            state.digests.add_truth(truth_words(split_ticks(batch)))
        state.last_ns = max(state.last_ns, pc.max(batch.column("time_ns")).as_py())
        if state.keeps(table):
            self._append(table, batch)
        else:
            state.leave_out(table, batch.num_rows)
