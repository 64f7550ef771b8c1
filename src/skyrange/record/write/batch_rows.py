"""Rows of the runs of a batch: frames, truth and sensors of all of them, encoded together, then divided by run.

Most of what it costs to encode observations does not depend on how many rows they have. What each run has alone, single
frames, notes, labels and alerts, waits in the run's own `WaitingRows`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.contracts.components import Sensors, World
from skyrange.contracts.frames import FrameBlock, Ints
from skyrange.core.time import NEVER, Time
from skyrange.record.digests import Words
from skyrange.record.write.rows.frame_encoder import FrameColumns, FrameEncoder, GatheredFrames
from skyrange.record.write.rows.ticks import (
    TruthTick,
    repeat_names,
    sensor_table,
    sensor_values,
    truth_words,
)
from skyrange.record.write.waiting_rows import WaitingRows, count_payload_bytes

_FRAMES: Final = 1 << 19
"""Frames of blocks that wait at most: about 100 MB of columns while they are written."""
_FRAME_BYTES: Final = 256 << 20
"""Bytes of their payloads that wait at most: more than so many frames of MAVLink have."""
_TICK_BYTES: Final = 32 << 20
"""Bytes of truth and sensors that wait at most; their words for the digest take as much again."""


Mask = NDArray[np.bool_]


class _SensorTick(NamedTuple):
    """Sensors of all runs at one tick, and what autopilots received where that is something else."""

    time_ns: Time
    values: NDArray[np.float32]
    received: NDArray[np.float32] | None
    differ: Mask
    """(n,) where `received` differs; empty without."""
    present: Mask | None
    """(n,) which bodies exist; `None` where all do."""


class TickRates(NamedTuple):
    """How often truth and sensors are recorded, in ns of simulated time: `NEVER` for never."""

    truth_ns: Time
    sensors_ns: Time


class BatchRows:
    """The blocks of frames and the ticks of all runs of a batch since the last write.

    Frames are for runs that count them and do not keep them, or keep them in memory: then all share one `encoder`.
    """

    def __init__(self, encoder: FrameEncoder | None, run_of_link: Ints, rates: TickRates) -> None:
        """`run_of_link` has the run of each directed link, by its number in the kernel."""
        self.encoder = encoder
        self._run_of_link = run_of_link
        self._rates = rates
        self._blocks: list[FrameBlock] = []
        self._rows = self._frame_bytes = 0
        self._truth: list[tuple[TruthTick, Mask | None]] = []
        self._sensors: list[_SensorTick] = []
        self._tick_bytes = 0
        self._truth_due = -NEVER if rates.truth_ns != NEVER else NEVER
        self._sensors_due = -NEVER if rates.sensors_ns != NEVER else NEVER
        self.runs: Sequence[WaitingRows] = ()
        """What waits of each run, by its number."""
        self.bodies: Sequence[slice] = ()
        """Rows of the world, by run."""
        self.vehicles: tuple[str, ...] = ()
        """The aircraft of each row of the world."""

    # ---------------------------------------------------------------- observations

    def on_blocks(self, blocks: Sequence[FrameBlock]) -> None:
        """Blocks that have met their fate; rows of them may be of any run."""
        self._blocks += blocks
        self._rows += sum(map(len, blocks))
        self._frame_bytes += sum(map(count_payload_bytes, blocks))
        if self._rows >= _FRAMES or self._frame_bytes >= _FRAME_BYTES:
            self.write_frames()

    def on_truth(self, now: Time, world: World, received: Sensors | None) -> None:
        """A tick of all runs ended; `received` are the readings that autopilots got, of all bodies of the world."""
        if now >= self._truth_due:
            self._truth_due = now - now % self._rates.truth_ns + self._rates.truth_ns
            tick = TruthTick(now, tuple(world.vehicles), tuple(world.sources), dict(world.truth()))
            self._truth.append((tick, world.present))
            self._tick_bytes += 8 * len(tick.columns) * len(tick.vehicles)
        if now >= self._sensors_due:
            self._sensors_due = now - now % self._rates.sensors_ns + self._rates.sensors_ns
            values = sensor_values(world.sensors(slice(0, len(world.vehicles))))
            got, differ = None, np.zeros(0, dtype=np.bool_)
            if received is not None:
                got = sensor_values(received)
                differ = (got.view(np.uint32) != values.view(np.uint32)).any(axis=1)
            self._sensors.append(_SensorTick(now, values, got, differ, world.present))
            self._tick_bytes += values.nbytes * (1 if got is None else 2)
        if self._tick_bytes >= _TICK_BYTES:
            self.write_ticks()

    # ---------------------------------------------------------------- frames

    def write_frames(self) -> None:
        """Count all frames that wait, each in its run."""
        encoder = self.encoder
        if encoder is None:
            return
        blocks, self._blocks = self._blocks, []
        self._rows = self._frame_bytes = 0
        singles = [(run, frames) for run in self.runs if (frames := run.take_frames())]
        parts: list[tuple[WaitingRows, GatheredFrames, Words]] = []
        if blocks:
            gathered = encoder.gather(blocks)
            parts += self._divide(blocks, gathered, encoder.words(gathered))
        for run, frames in singles:
            gathered = encoder.gather(frames)
            parts.append((run, gathered, encoder.words(gathered)))
        payloads: pa.RecordBatch = encoder.take_payloads()
        if self.runs[0].keeps("frames"):
            for run in self.runs:
                own = [(gathered, words) for of_run, gathered, words in parts if of_run is run]
                if own:
                    run.keep_frames(*_merge_parts(own), payloads)
            return
        for run, gathered, words in parts:
            run.count_frames(gathered, words, payloads)

    def _divide(
        self, blocks: Sequence[FrameBlock], gathered: GatheredFrames, words: Words
    ) -> list[tuple[WaitingRows, GatheredFrames, Words]]:
        """The rows of each run, in their order."""
        numbers = self._run_of_link[np.concatenate([block.link_numbers for block in blocks])]
        order = numbers.argsort(kind="stable")
        columns = _take(gathered.columns, order)
        words, numbers = words[order], numbers[order]
        starts = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        causes = sorted((place.item(row), ids) for row, ids in gathered.causes.items())
        parts = []
        for start, end in pairwise(starts):
            rows = slice(start, end)
            own = {row - start: ids for row, ids in causes if start <= row < end} if causes else {}
            found = GatheredFrames(_take(columns, rows), own)
            parts.append((self.runs[numbers.item(start)], found, words[rows]))
        return parts

    # ---------------------------------------------------------------- ticks

    def write_ticks(self) -> None:
        """Write the truth and the sensors that wait, each run's rows to its own tables."""
        truth, self._truth = self._truth, []
        sensors, self._sensors = self._sensors, []
        self._tick_bytes = 0
        if truth:
            ticks = [tick for tick, _ in truth]
            self._write_truth(ticks, _stack_present([present for _, present in truth], len(ticks[0].vehicles)))
        if sensors:
            self._write_sensors(sensors)

    def _write_truth(self, ticks: Sequence[TruthTick], present: Mask | None) -> None:
        first, count = ticks[0], len(ticks)
        bodies = len(first.vehicles)
        words = truth_words(ticks).reshape(count, bodies, -1)
        columns = {name: np.stack([tick.columns[name] for tick in ticks]) for name in first.columns}
        times = np.array([tick.time_ns for tick in ticks], dtype=np.int64)
        for run, rows in zip(self.runs, self.bodies, strict=True):
            size = rows.stop - rows.start
            own_words = words[:, rows].reshape(count * size, -1)
            exist = _mask_of(present, rows)
            if exist is not None:
                own_words = own_words[exist]
            if not run.keeps("truth"):
                run.write_truth(own_words, None, int(times[-1]))
                continue
            arrays = [
                pa.array(np.repeat(times, size)),
                repeat_names(first.vehicles[rows], count),
                repeat_names(first.sources[rows], count),
                *(pa.array(column[:, rows].reshape(-1)) for column in columns.values()),
            ]
            table = pa.RecordBatch.from_arrays(arrays, names=["time_ns", "vehicle", "source", *columns])
            run.write_truth(own_words, table if exist is None else table.filter(pa.array(exist)), int(times[-1]))

    def _write_sensors(self, ticks: Sequence[_SensorTick]) -> None:
        times = np.array([tick.time_ns for tick in ticks], dtype=np.int64)
        values = np.stack([tick.values for tick in ticks])
        got = [tick for tick in ticks if tick.received is not None]
        got_times = np.array([tick.time_ns for tick in got], dtype=np.int64)
        received = np.stack([tick.received for tick in got if tick.received is not None]) if got else None
        differ = np.stack([tick.differ for tick in got]) if got else None
        present = _stack_present([tick.present for tick in ticks], len(self.vehicles))
        if differ is not None:
            got_present = _stack_present([tick.present for tick in got], len(self.vehicles))
            differ = differ if got_present is None else differ & got_present
        for run, rows in zip(self.runs, self.bodies, strict=True):
            vehicles = self.vehicles[rows]
            size, count = rows.stop - rows.start, len(ticks)
            names = repeat_names(vehicles, count)
            own = values[:, rows].reshape(count * size, -1)
            table, exist = sensor_table(np.repeat(times, size), names, own), _mask_of(present, rows)
            run.write_sensors("sensors", table if exist is None else table.filter(pa.array(exist)), int(times[-1]))
            if received is None or differ is None or not differ[:, rows].any():
                continue
            chosen = differ[:, rows].reshape(-1)
            names = repeat_names(vehicles, len(got)).filter(pa.array(chosen))
            own = received[:, rows].reshape(len(got) * size, -1)[chosen]
            run.write_sensors("received_sensors", sensor_table(np.repeat(got_times, size)[chosen], names, own), 0)


def _stack_present(ticks: Sequence[Mask | None], bodies: int) -> Mask | None:
    """(ticks, bodies) which bodies exist; `None` where all always do."""
    if all(present is None for present in ticks):
        return None
    return np.stack([np.ones(bodies, dtype=np.bool_) if present is None else present for present in ticks])


def _mask_of(present: Mask | None, rows: slice) -> Mask | None:
    """Which of a run's rows, tick by tick, are of bodies that exist; `None` where all are."""
    if present is None or present[:, rows].all():
        return None
    return present[:, rows].reshape(-1)


def _merge_parts(parts: Sequence[tuple[GatheredFrames, Words]]) -> tuple[GatheredFrames, Words]:
    """Frames of one run in the order in which they met their fate."""
    columns = FrameColumns(*map(np.concatenate, zip(*(gathered.columns for gathered, _ in parts), strict=True)))
    ended = np.where(columns.arrived < columns.sent, columns.sent, columns.arrived)  # of a lost frame it is no time
    ended = np.where(columns.arrived >= NEVER, columns.sent, ended)
    order = ended.argsort(kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    causes: dict[int, Sequence[str]] = {}
    first = 0
    for gathered, _ in parts:
        causes |= {place.item(first + row): ids for row, ids in gathered.causes.items()}
        first += gathered.rows
    words = np.concatenate([own for _, own in parts])[order]
    return GatheredFrames(_take(columns, order), dict(sorted(causes.items()))), words


def _take(columns: FrameColumns, rows: Ints | slice) -> FrameColumns:
    """Some rows of columns; a column that has none, because nobody wants it, stays as it is."""
    taken: list[Any] = [column[rows] if len(column) else column for column in columns]
    return FrameColumns(*taken)
