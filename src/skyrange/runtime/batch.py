"""Batch of runs: several runs of like scenarios that fly in one kernel, each with a record of its own."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from skyrange.assembly.batches import BuiltBatch, build_batch
from skyrange.assembly.build import Additions, BuiltScenario
from skyrange.contracts.monitors import MonitorPlacement
from skyrange.core.errors import ShortfallError
from skyrange.core.time import NEVER, NS_PER_S, Time, to_seconds
from skyrange.kernel import Kernel
from skyrange.record import Recorder, RunRecord, load
from skyrange.record.schema import FULL, SUMMARY
from skyrange.record.write.batch_rows import BatchRows, TickRates
from skyrange.record.write.memory_recorder import MemoryRecorder
from skyrange.record.write.recorder import WINDOW_BYTES
from skyrange.record.write.recording_state import make_encoder, period_ns
from skyrange.runtime.interrupt import Interruptible
from skyrange.runtime.memory import collect_seldom
from skyrange.runtime.run import OnProgress, Run, open_record
from skyrange.scenario.model.scenario import Scenario

STEP_NS: Time = NS_PER_S
"""Simulated time between two checks of Ctrl-C."""


class BatchedFlight(NamedTuple):
    """One of the runs of a batch."""

    scenario: Scenario
    folder: Path
    in_memory: bool = False
    """Whether nothing is written to the folder: its record is read in memory, once it has ended."""
    monitors: Sequence[MonitorPlacement] = ()
    """Monitors that listen beside the detectors of the scenario."""


class RunBatch:
    """Runs that fly together: each has the record that it would have alone."""

    def __init__(self, kernel: Kernel, built: BuiltBatch, recorders: Sequence[Recorder], setup_s: float) -> None:
        """Use `RunBatch.start`."""
        self._kernel = kernel
        self._built = built
        share_s = setup_s / len(recorders)
        self.runs = [
            Run(kernel, recorder, run, share_s, number=number)
            for number, (recorder, run) in enumerate(zip(recorders, built.runs, strict=True))
        ]

    @classmethod
    def start(cls, flights: Sequence[BatchedFlight]) -> RunBatch:
        """Build scenarios that have the same `batch_key`, and open the record of each.

        Raises the errors of `Run.start`, and `ValueError` for scenarios that cannot fly together.
        """
        began = time.perf_counter()
        with collect_seldom():
            built = build_batch(
                [flight.scenario for flight in flights], [Additions(monitors=flight.monitors) for flight in flights]
            )
            kernel = Kernel.of_batch(
                [run.wiring for run in built.runs], [()] * len(flights), built.world, built.engines
            )
            rows = _share_rows(kernel, built, in_memory=all(flight.in_memory for flight in flights))
            recorders = []
            for number, (flight, run) in enumerate(zip(flights, built.runs, strict=True)):
                recorder = _open_record(flight, run, rows)
                recorder.attach_files(run.files)
                recorder.record_receptions(run.oracle)
                if not flight.in_memory:  # no measure reads the truth of scans, and memory is short
                    recorder.record_scans(run.scanner)
                kernel.set_observers([recorder], number)
                recorders.append(recorder)
            rows.runs = [recorder.join_batch(rows) for recorder in recorders]
        return cls(kernel, built, recorders, time.perf_counter() - began)

    def records(self) -> list[RunRecord]:
        """The records of all runs, by number, once they have ended."""
        recorders = (run.recorder for run in self.runs)
        return [
            recorder.read() if isinstance(recorder, MemoryRecorder) else load(recorder.path) for recorder in recorders
        ]

    def execute(self, on_progress: OnProgress | None = None) -> None:
        """Fly all runs to their end, and close their records.

        Ctrl-C, or a component's failure in any run, ends all of them early, as `Run.execute` does.
        """
        kernel, end = self._kernel, self._built.runs[0].duration_ns
        with Interruptible() as interrupt, collect_seldom():
            began = time.perf_counter()
            try:
                while kernel.now < end and not interrupt.requested:
                    kernel.advance(min(max(kernel.now, 0) + STEP_NS, end))
                    if on_progress is not None:
                        on_progress(kernel.now, end)
            except Exception as error:
                for run in self.runs:
                    run.fail(error)
                raise
            share_s = (time.perf_counter() - began) / len(self.runs)
            ended_early = interrupt.requested and kernel.now < end
            for run in self.runs:
                run.note_wall(share_s)
                run.finish("interrupted" if ended_early else "complete")
        if ended_early:
            path = self.runs[0].recorder.path
            raise ShortfallError(f"interrupted at {to_seconds(kernel.now):.1f} simulated seconds", path)


def _read(recorder: Recorder) -> RunRecord:
    return recorder.read() if isinstance(recorder, MemoryRecorder) else load(recorder.path)


def _open_record(flight: BatchedFlight, built: BuiltScenario, rows: BatchRows) -> Recorder:
    if not flight.in_memory:
        return open_record(built, flight.folder, flush_s=math.inf, encoder=rows.encoder)
    record = built.scenario.record
    return MemoryRecorder.begin(
        flight.folder,
        built.header,
        truth_hz=record.truth_hz,
        sensors_hz=record.sensors_hz,
        level=record.level,
        features_hz=record.features_hz,
        encoder=rows.encoder,
    )


def _share_rows(kernel: Kernel, built: BuiltBatch, *, in_memory: bool) -> BatchRows:
    """What all runs write together: ticks, and frames unless they are written to a folder."""
    record = built.runs[0].scenario.record
    shared = in_memory or record.level != FULL
    encoder = make_encoder(record.level, WINDOW_BYTES) if shared else None
    sensors_ns = NEVER if record.level == SUMMARY else period_ns(record.sensors_hz)
    rows = BatchRows(encoder, kernel.run_of_link, TickRates(period_ns(record.truth_hz), sensors_ns))
    rows.bodies = [built.world.rows_of(number) for number in range(len(built.runs))]
    rows.vehicles = tuple(built.world.vehicles)
    kernel.observe_batch(rows, blocks=shared)
    return rows
