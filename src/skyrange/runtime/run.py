"""What is a run? A wired scenario, a kernel and a recorder, driven to the end or to wherever it stops."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from skyrange.agent.contracts import Observer
from skyrange.agent.links import AttackPlan, TapPlacement
from skyrange.agent.monitors import MonitorPlacement
from skyrange.core.errors import ComponentError, InputError, ShortfallError, SkyrangeError
from skyrange.core.time import NS_PER_S, Time, from_seconds, to_seconds
from skyrange.kernel import Kernel
from skyrange.radio.oracle import Oracle
from skyrange.record import Recorder
from skyrange.runtime.collector import at_ease
from skyrange.runtime.interrupt import Interruptible
from skyrange.runtime.memory import peak_memory_mb
from skyrange.runtime.pace import Pace, held_to
from skyrange.runtime.warm import warm_up
from skyrange.scenario.aircraft import engines_told
from skyrange.scenario.schema import Scenario
from skyrange.scenario.wire import Rig, wire

OnProgress = Callable[[Time, Time], None]
"""Called with (simulated now, simulated end) between steps; `now` is negative while autopilots boot."""
BOOT_STEP_NS: Time = NS_PER_S
"""How much a run advances between two looks at Ctrl-C while autopilots boot."""


class Run:
    """One run of a scenario into one folder.

    `Run.start` checks everything and writes nothing where something is wrong. Then `advance` as far
    as wanted, `fork` at will, and `finish`; `execute` does it all.
    """

    def __init__(self, kernel: Kernel, recorder: Recorder, rig: Rig) -> None:
        self.kernel = kernel
        self.recorder = recorder
        self.rig = rig
        self._wall_s = 0.0
        self._finished = False

    @classmethod
    def start(
        cls,
        scenario: Scenario,
        out: Path | None = None,
        *,
        speed: float = 0.0,
        taps: Sequence[TapPlacement] = (),
        attacks: Sequence[AttackPlan] = (),
        monitors: Sequence[MonitorPlacement] = (),
        observers: Sequence[Observer] = (),
        fuse: bool = True,
        motion: bool = False,
    ) -> Run:
        """Wire `scenario` and open the run folder `out`. Raises `InputError` before anything is written.

        Without `out` it is the first of `runs/NAME`, `runs/NAME-2` … that is free, whoever else starts a run there.
        `taps` and `attacks` act on its links, `monitors` listen at ends of them; `observers` see everything beside the
        recorder. `speed` is what
        `execute` will be asked for: whether the engines allow it is known once they are made.
        What a frame does on several links in a row they hear at its end, and without `fuse` as it happens; the
        record is the same. `motion` lets external vehicles be moved, where the scenario allows it too.
        """
        rig = wire(scenario, taps=taps, attacks=attacks, monitors=monitors, motion=motion)
        held_to(speed, [mount.engine for mount in rig.wiring.engines])
        kernel = Kernel(replace(rig.wiring, fuse=fuse))
        recorder = open_record(rig, out)
        recorder.listen(rig.oracle)
        kernel.observe([recorder, *observers])
        return cls(kernel, recorder, rig)

    @property
    def now(self) -> Time:
        """Simulated time reached, in nanoseconds."""
        return max(self.kernel.now, 0)

    @property
    def on_wall_clock(self) -> bool:
        """Whether engines of it have a pace of their own."""
        return any(mount.engine.clock == "wall" for mount in self.rig.wiring.engines)

    def advance(self, until_s: float) -> None:
        """Run every instant up to `until_s` simulated seconds, as fast as engines on the wall clock let it."""
        began = time.perf_counter()
        pace, until = Pace(held_to(0.0, [mount.engine for mount in self.rig.wiring.engines])), from_seconds(until_s)
        try:
            with at_ease():
                while pace.held and self.kernel.now < until:
                    self.kernel.advance(self._next(pace.step_ns, until))
                    if self.kernel.now >= 0:
                        pace.wait(self.kernel.now)
                self.kernel.advance(until)
        finally:
            self._wall_s += time.perf_counter() - began

    def fork(self, out: Path) -> Run:
        """A second run that continues from here into the folder `out`, with what was recorded so far."""
        recorder = self.recorder.fork(out)
        kernel = self.kernel.fork([recorder])
        twin = Run(kernel, recorder, self.rig)
        recorder.listen(twin._oracle())
        twin._wall_s = self._wall_s
        return twin

    def execute(self, *, speed: float = 0.0, on_progress: OnProgress | None = None) -> None:
        """Run to the scenario's end and close the record.

        `speed` holds it to that many simulated seconds per wall second; 0 is as fast as it goes, or as engines on
        the wall clock let it.
        Ctrl-C, or a component's failure, ends it early: the record is whole up to there, its status
        `interrupted` or `failed`, and `ShortfallError` or the component's error is raised.
        """
        engines = [mount.engine for mount in self.rig.wiring.engines]
        pace = Pace(held_to(speed, engines))
        end = self.rig.duration_ns
        with Interruptible() as interrupt, at_ease():
            began = time.perf_counter()
            try:
                if not all(engine.waits for engine in engines):
                    warm_up(self.rig.scenario)  # what flies outside does not wait while we compile
                    began = time.perf_counter()
                while self.kernel.now < end and not interrupt.requested:
                    self.kernel.advance(self._next(pace.step_ns, end))
                    if self.kernel.now >= 0:
                        pace.wait(self.kernel.now)
                    if on_progress is not None:
                        on_progress(self.kernel.now, end)
            except Exception as error:  # whatever broke, the record says so
                self._wall_s += time.perf_counter() - began
                self._fail(str(error) if isinstance(error, SkyrangeError) else repr(error))
                raise
            self._wall_s += time.perf_counter() - began
            self.finish("interrupted" if interrupt.requested and self.kernel.now < end else "complete", pace.lag_s)
        if interrupt.requested and self.kernel.now < end:
            raise ShortfallError(
                f"interrupted at {to_seconds(self.now):.1f} of {to_seconds(end):.1f} simulated seconds; "
                f"what was recorded is in {self.recorder.path}",
                self.recorder.path,
            )

    def _next(self, step_ns: Time, end: Time) -> Time:
        """Where the next stretch ends; engines that boot before 0 do so in stretches of their own."""
        now = self.kernel.now
        return min(now + BOOT_STEP_NS, 0) if now < -1 else min(max(now, 0) + step_ns, end)

    def finish(self, status: str = "complete", lag_s: float = 0.0) -> None:
        """Close the record at the time reached. Idempotent."""
        if self._finished:
            return
        self._finished = True
        self._end()
        self.recorder.close(status, self._summary(lag_s))

    def _fail(self, reason: str) -> None:
        """Keep what can be kept; the reason for the failure matters more than a failure to note it."""
        self._finished = True
        try:
            self._end()
            self.recorder.close("failed", {**self._summary(0.0), "error": reason})
        except ComponentError as error:
            print(f"skyrange: {error}", file=sys.stderr)

    def _oracle(self) -> Oracle | None:
        """The oracle of this run's kernel: a fork has another than its stem."""
        name = self.rig.oracle.name if self.rig.oracle is not None else None
        return None if name is None else cast("Oracle", self.kernel.watcher(name))

    def _end(self) -> None:
        """End the kernel and its programs; what these leave goes into the folder."""
        oracle = self._oracle()
        try:
            for name, path in self.kernel.leaves().items():
                self.recorder.keep(name, path)
        finally:
            self.kernel.finish()
            if oracle is not None:
                oracle.close()

    def _summary(self, lag_s: float) -> dict[str, Any]:
        simulated_s = to_seconds(self.now)
        return {
            "simulated_s": simulated_s,
            "engines": engines_told(self.rig.wiring.engines),
            "timings": {
                "wall_s": round(self._wall_s, 3),
                "real_time_factor": round(simulated_s / self._wall_s, 3) if self._wall_s else None,
                "max_lag_s": round(lag_s, 3),
                "peak_memory_mb": round(peak_memory_mb(), 1),
            },
        }


def open_record(rig: Rig, out: Path | None) -> Recorder:
    """Begin the record of a rig's run in `out`, or in a folder that is free, with the scenario as flown in it."""
    scenario, record = rig.scenario, rig.scenario.record
    while True:
        folder = out if out is not None else free_folder(scenario.name)
        try:
            recorder = Recorder.open(folder, rig.header, truth_hz=record.truth_hz, sensors_hz=record.sensors_hz)
            break
        except InputError:
            if out is not None or free_folder(scenario.name) == folder:
                raise  # else another run took the folder meanwhile
    for name, data in rig.attachments.items():
        recorder.attach(name, data)
    return recorder


def free_folder(name: str, parent: Path = Path("runs")) -> Path:
    """The first of `parent/name`, `parent/name-2`, `parent/name-3` … that does not exist."""
    stem = "".join(char if char.isalnum() or char in "._-" else "-" for char in name)
    number = 1
    while True:
        path = parent / (stem if number == 1 else f"{stem}-{number}")
        if not os.path.lexists(path):
            return path
        number += 1
