"""A run: a scenario's agents and links, a kernel and a recorder, driven to the end or until it is stopped."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, cast

from skyrange.assembly.aircraft import describe_engines
from skyrange.assembly.build import NOTHING_MORE, Additions, BuiltScenario, build
from skyrange.core.errors import ComponentError, InputError, ShortfallError, SkyrangeError
from skyrange.core.time import NS_PER_S, Time, from_seconds, to_seconds
from skyrange.kernel import Kernel
from skyrange.optics.scanner import Scanner
from skyrange.radio.oracle import Oracle
from skyrange.record import Recorder
from skyrange.record.write.rows.frame_encoder import FrameEncoder
from skyrange.runtime.acts import RunAct, describe_manual_acts, list_acts, list_manual_acts, list_unstarted
from skyrange.runtime.interrupt import Interruptible
from skyrange.runtime.memory import collect_seldom, peak_memory_mb
from skyrange.runtime.pace import Pace, resolve_speed
from skyrange.runtime.warm_up import warm_up
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import replace_manual_acts

OnProgress = Callable[[Time, Time], None]
"""Called with (simulated now, simulated end) between steps; `now` is negative while autopilots boot."""
PAUSED_S: Final = 0.02
"""Wall time between two calls of `on_progress` while a run is paused."""
BOOT_STEP_NS: Time = NS_PER_S
"""Simulated time between two checks of Ctrl-C while autopilots boot."""


SCENARIO: Final = "scenario.toml"
"""The file of a run's folder that repeats the run."""


class Run:
    """One run of a scenario into one folder.

    `Run.start` checks everything, and writes nothing if something is wrong. Then call `advance` as far as wanted,
    `fork` at will, and `finish`; `execute` does all of it.
    """

    def __init__(
        self, kernel: Kernel, recorder: Recorder, built: BuiltScenario, setup_s: float = 0.0, *, number: int = 0
    ) -> None:
        """`setup_s` is how long it took to build, in wall seconds; `number` is its own in the batch of the kernel."""
        self.kernel = kernel
        self.recorder = recorder
        self.built = built
        self._setup_s = setup_s
        self._number = number
        self._wall_s = 0.0
        self._finished = False
        self._pace: Pace | None = None
        self._paused = False

    @classmethod
    def start(
        cls,
        scenario: Scenario,
        out: Path | None = None,
        *,
        additions: Additions = NOTHING_MORE,
        speed: float = 0.0,
        fuse: bool = True,
        motion: bool = False,
        more: Mapping[str, Any] = MappingProxyType({}),
    ) -> Run:
        """Build `scenario` and open the run folder `out`. Raises `InputError` before anything is written.

        Without `out` it is the first free one of `runs/NAME`, `runs/NAME-2` …, even if other runs start there.
        `speed` is what `execute` will be asked for: whether the engines allow it is known once they are made.
        What a frame does on several links in a row they hear at its end, and without `fuse` as it happens; the
        record is the same. `motion` lets external vehicles be moved, where the scenario allows it too. `more` are
        further entries of the manifest.
        """
        began = time.perf_counter()
        with collect_seldom():
            built = build(scenario, additions, motion=motion)
            resolve_speed(speed, [mount.engine for mount in built.wiring.engines])
            built.header |= more
            kernel = Kernel(replace(built.wiring, fuse=fuse))
            recorder = open_record(built, out)
            recorder.attach_files(built.files)
        recorder.record_receptions(built.oracle)
        recorder.record_scans(built.scanner)
        kernel.set_observers([recorder, *additions.observers])
        return cls(kernel, recorder, built, time.perf_counter() - began)

    @property
    def now(self) -> Time:
        """Simulated time reached, in nanoseconds."""
        return max(self.kernel.now, 0)

    @property
    def on_wall_clock(self) -> bool:
        """Whether any of its engines has a pace of its own."""
        return any(mount.engine.clock == "wall" for mount in self.built.wiring.engines)

    def advance(self, until_s: float) -> None:
        """Run every instant up to `until_s` simulated seconds, as fast as engines on the wall clock allow."""
        began = time.perf_counter()
        pace, until = (
            Pace(resolve_speed(0.0, [mount.engine for mount in self.built.wiring.engines])),
            from_seconds(until_s),
        )
        try:
            with collect_seldom():
                while pace.held and self.kernel.now < until:
                    self.kernel.advance(self._next(pace.step_ns, until))
                    if self.kernel.now >= 0:
                        pace.wait(self.kernel.now)
                self.kernel.advance(until)
        finally:
            self._wall_s += time.perf_counter() - began

    @property
    def acts(self) -> Mapping[str, RunAct]:
        """Its attacks, faults and defences by id, to start and stop them by hand between two steps.

        What was done is in the manifest, and `scenario.toml` of the finished folder has it as `manual_acts`: flown, it
        gives the same fingerprint.
        """
        return list_acts(self.kernel, self.built, self._number)

    def fork(self, out: Path) -> Run:
        """A second run that continues from here into the folder `out`, with a copy of the record so far.

        What is started or stopped by hand in one of them from now on happens in that one alone.
        """
        recorder = self.recorder.fork(out)
        kernel = self.kernel.fork([recorder])
        twin = Run(kernel, recorder, self.built, self._setup_s)
        recorder.record_receptions(twin._oracle())
        if built_scanner := self.built.scanner:
            recorder.record_scans(cast("Scanner", kernel.truth_subscriber(built_scanner.name)))
        twin._wall_s = self._wall_s
        return twin

    def execute(self, *, speed: float = 0.0, on_progress: OnProgress | None = None) -> None:
        """Run to the scenario's end and close the record.

        `speed` holds it to that many simulated seconds per wall second; 0 is as fast as possible, or as engines on the
        wall clock allow.
        Ctrl-C, or a component's failure, ends it early: the record is complete up to there, its status `interrupted`
        or `failed`, and `ShortfallError` or the component's error is raised. Between two steps `on_progress` may start
        and stop acts (`acts`), `pause` and `resume`, and `set_speed`.
        """
        engines = [mount.engine for mount in self.built.wiring.engines]
        pace = self._pace = Pace(resolve_speed(speed, engines))
        end = self.built.duration_ns
        with Interruptible() as interrupt, collect_seldom():
            began = time.perf_counter()
            try:
                if not all(engine.paces_itself for engine in engines):
                    warm_up(self.built.scenario)  # vehicles outside the range do not wait for a compilation
                    self._setup_s += time.perf_counter() - began
                    began = time.perf_counter()
                while self.kernel.now < end and not interrupt.requested:
                    if self._paused:
                        time.sleep(PAUSED_S)
                    else:
                        self.kernel.advance(self._next(pace.step_ns, end))
                        if self.kernel.now >= 0:
                            pace.wait(self.kernel.now)
                    if on_progress is not None:
                        on_progress(self.kernel.now, end)
            except Exception as error:  # the record states any failure
                self._wall_s += time.perf_counter() - began
                self.fail(error)
                raise
            self._wall_s += time.perf_counter() - began
            self.finish("interrupted" if interrupt.requested and self.kernel.now < end else "complete", pace.lag_s)
        if interrupt.requested and self.kernel.now < end:
            raise ShortfallError(
                f"interrupted at {to_seconds(self.now):.1f} of {to_seconds(end):.1f} simulated seconds; "
                f"what was recorded is in {self.recorder.path}",
                self.recorder.path,
            )

    @property
    def paused(self) -> bool:
        """Whether `execute` stands still."""
        return self._paused

    def pause(self) -> None:
        """Have `execute` stand still after its present step, and go on calling `on_progress`.

        Raises `InputError` where an engine runs on the machine's clock, which cannot stand still.
        """
        if self.on_wall_clock:
            raise InputError.one(
                "run", "pause", "autopilots on the machine's clock", "autopilots that wait for the range"
            )
        self._paused = True

    def resume(self) -> None:
        """Have `execute` go on. The time that it stood still does not count as a delay."""
        self._paused = False
        if self._pace is not None:
            self._pace.change(self._pace.speed)

    @property
    def speed(self) -> float:
        """The speed to which `execute` holds the run; 0 is as fast as possible, or at the pace of its engines."""
        return self._pace.speed if self._pace is not None else 0.0

    def set_speed(self, speed: float) -> None:
        """Hold the run that `execute` flies to another speed from now on.

        Raises `InputError` for what is no speed, and for one that contradicts engines on the wall clock.
        """
        resolved = resolve_speed(speed, [mount.engine for mount in self.built.wiring.engines])
        if self._pace is not None:
            self._pace.change(resolved)

    def _next(self, step_ns: Time, end: Time) -> Time:
        """The end of the next step; engines that boot before time 0 have steps of their own."""
        now = self.kernel.now
        return min(now + BOOT_STEP_NS, 0) if now < -1 else min(max(now, 0) + step_ns, end)

    def note_wall(self, wall_s: float) -> None:
        """Count wall seconds of a flight that something else has timed."""
        self._wall_s += wall_s

    def finish(self, status: str = "complete", lag_s: float = 0.0) -> None:
        """Close the record at the time reached. A second call does nothing."""
        if self._finished:
            return
        self._finished = True
        self._end()
        self.recorder.close(status, partial(self._summary, lag_s))

    def fail(self, cause: Exception) -> None:
        """Close the record as failed; an error in doing so is only noted at `cause`, which matters more."""
        self._finished = True
        reason = str(cause) if isinstance(cause, SkyrangeError) else repr(cause)
        try:
            self._end()
            self.recorder.close("failed", lambda finish_s: {**self._summary(0.0, finish_s), "error": reason})
        except ComponentError as error:
            cause.add_note(str(error))

    def _oracle(self) -> Oracle | None:
        """The oracle of this run's kernel: a fork has another than its stem."""
        name = self.built.oracle.name if self.built.oracle is not None else None
        return None if name is None else cast("Oracle", self.kernel.truth_subscriber(name, self._number))

    def _end(self) -> None:
        """End the kernel and its programs, and copy the files that these leave into the folder."""
        oracle = self._oracle()
        try:
            self._keep_manual_acts()
            for name, path in self.kernel.kept_files().items():
                self.recorder.keep_file(name, path)
        finally:
            self.kernel.finish()
            if oracle is not None:
                oracle.close()

    def _keep_manual_acts(self) -> None:
        """Add what was started and stopped by hand to the scenario in the folder."""
        acts = list_manual_acts(self.kernel, self._number)
        if set(acts) != set(self.built.scenario.manual_acts) and SCENARIO in self.built.attachments:
            text = replace_manual_acts(self.built.attachments[SCENARIO].decode(), acts)
            self.recorder.replace_file(SCENARIO, text.encode())

    def _summary(self, lag_s: float, finish_s: float) -> dict[str, Any]:
        """Entries of the manifest; `finish_s` is how long the recorder took to finish."""
        simulated_s = to_seconds(self.now)
        unstarted = list_unstarted(act.describe() for act in self.acts.values())
        return {
            "simulated_s": simulated_s,
            "engines": describe_engines(self.built.wiring.engines),
            "timings": summarise_timings(
                simulated_s, self._setup_s, self._wall_s, finish_s, max_lag_s=lag_s, peak_memory_mb=peak_memory_mb()
            ),
            **({"manual_acts": manual} if (manual := describe_manual_acts(self.kernel, self._number)) else {}),
            **({"warnings": [*self.built.header.get("warnings", ()), *unstarted]} if unstarted else {}),
            **({"withheld": list(withheld)} if (withheld := self.kernel.withheld_in(self._number)) else {}),
        }


def summarise_timings(
    simulated_s: float, setup_s: float, wall_s: float, finish_s: float, *, max_lag_s: float, peak_memory_mb: float
) -> dict[str, float | None]:
    """The manifest's `timings`: of the set-up, the flight and the finishing of the record, in wall seconds, and what
    share of the simulated time these are.
    """
    total_s = setup_s + wall_s + finish_s
    return {
        "setup_s": round(setup_s, 3),
        "wall_s": round(wall_s, 3),
        "finish_s": round(finish_s, 3),
        "real_time_factor": round(simulated_s / wall_s, 3) if wall_s else None,
        "total_factor": round(simulated_s / total_s, 3) if total_s else None,
        "max_lag_s": round(max_lag_s, 3),
        "peak_memory_mb": round(peak_memory_mb, 1),
    }


def open_record(
    built: BuiltScenario, out: Path | None, *, flush_s: float = 1.0, encoder: FrameEncoder | None = None
) -> Recorder:
    """Open the record of a run in `out`, or in a free folder; its files are for the caller to attach. `flush_s` and
    `encoder` are those of `Recorder.open`.
    """
    scenario, record = built.scenario, built.scenario.record
    while True:
        folder = out if out is not None else free_folder(scenario.name)
        try:
            return Recorder.open(
                folder,
                built.header,
                truth_hz=record.truth_hz,
                sensors_hz=record.sensors_hz,
                level=record.level,
                features_hz=record.features_hz,
                csv=record.csv,
                flush_s=flush_s,
                encoder=encoder,
            )
        except InputError:
            if out is not None or free_folder(scenario.name) == folder:
                raise  # else another run has taken the folder meanwhile


def free_folder(name: str, parent: Path = Path("runs")) -> Path:
    """The first of `parent/name`, `parent/name-2`, `parent/name-3` … that does not exist."""
    stem = "".join(char if char.isalnum() or char in "._-" else "-" for char in name)
    number = 1
    while True:
        path = parent / (stem if number == 1 else f"{stem}-{number}")
        if not os.path.lexists(path):
            return path
        number += 1
