"""Flight of planned runs in one process: complete ones are taken over, others fly together where they can, or alone."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

from skyrange.assembly.batches import batch_key, count_together
from skyrange.assembly.build import Additions
from skyrange.contracts.components import Observer
from skyrange.contracts.monitors import MonitorPlacement
from skyrange.core.errors import ComponentError, InputError, ShortfallError, SkyrangeError
from skyrange.core.ids import hash64
from skyrange.core.time import Time
from skyrange.record import RunRecord, load
from skyrange.runtime.batch import BatchedFlight, RunBatch
from skyrange.runtime.event_reports import MAX_STATES, EventCollector, EventReport
from skyrange.runtime.memory import RunGarbage
from skyrange.runtime.run import OnProgress
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.execution.plan import PlannedRun
from skyrange.study.feature_windows import WINDOWS, WindowCollector, make_collector, place_collector, write_windows
from skyrange.study.runs import fly

WINDOWS_FILE: Final = f"{WINDOWS}.parquet"
"""File of the windows of a run, in its folder."""

CHECKED_SHARE: Final = 50
"""One in so many runs of batches flies alone as well."""
EVENT_REPORTS: Final = 200
"""Reports of what happens in a run, at most: a flood of acts is told as rarely as one of them."""
OnEvents = Callable[[str, EventReport], None]
"""Callback with the folder of a run that flies alone, and what happened in it."""
OnFlown = Callable[[float], None]
"""Callback for progress: how many of the runs are flown, those under way by the share of their simulated time."""
Stop = Callable[[], bool]
"""Whether no further run is to begin."""


_GARBAGE: Final = RunGarbage()
"""Of this process."""


class DiskFullError(ComponentError):
    """Nothing more can be written: everything ends."""


class Flown(NamedTuple):
    """What became of runs, by folder: the records, and why others have none."""

    records: Mapping[str, RunRecord]
    errors: Mapping[str, str]
    remarks: Sequence[str]
    """What a user should know beside that."""


def fly_runs(
    runs: Sequence[PlannedRun],
    root: Path,
    on_flown: OnFlown | None = None,
    *,
    stop: Stop | None = None,
    on_events: OnEvents | None = None,
) -> Flown:
    """Fly runs into their folders below `root`; a run that fails has its error in the result.

    Those that can fly together do, in one kernel (`assembly.batches`); the others fly one after the other. If anything
    fails in a batch, all of it flies again, each run alone, so that the one that fails says why. Some of the runs of
    batches, chosen by their names, fly alone as well: one that is not the same fails.

    Raises `ShortfallError` where a signal or `stop` ends it, `DiskFullError` when nothing more can be written.
    """
    session = _Session(root, on_flown, stop, on_events)
    batches: dict[Hashable, list[PlannedRun]] = {}
    alone: list[PlannedRun] = []
    for planned in runs:
        scenario = planned.scenario
        if isinstance(scenario, InputError):
            session.errors[planned.folder] = str(scenario)
            session.count(1)
        elif session.take_complete(planned, scenario):
            session.count(1)
        elif planned.report or count_together(scenario) == 1:
            alone.append(planned)
        else:
            batches.setdefault((batch_key(scenario), planned.in_memory), []).append(planned)
    for group in batches.values():
        size = min(count_together(run.scenario) for run in group if isinstance(run.scenario, Scenario))
        for start in range(0, len(group), size):
            batch = group[start : start + size]
            alone += session.fly_batch(batch)
    for planned in alone:
        session.fly_alone(planned)
    return Flown(session.records, session.errors, session.remarks)


class _Session:
    """One call of `fly_runs`."""

    def __init__(self, root: Path, on_flown: OnFlown | None, stop: Stop | None, on_events: OnEvents | None) -> None:
        self.records: dict[str, RunRecord] = {}
        self.errors: dict[str, str] = {}
        self.remarks: list[str] = []
        self._root = root
        self._on_flown = on_flown
        self._stop = stop
        self._on_events = on_events
        self._flown = 0

    def count(self, runs: int) -> None:
        """Count runs that are done."""
        self._flown += runs
        if self._on_flown is not None:
            self._on_flown(float(self._flown))

    def take_complete(self, planned: PlannedRun, scenario: Scenario) -> bool:
        """Take over a run that was flown before, here or where `same_as` says; what is left of another is deleted."""
        record = _find_complete(planned, scenario, self._root / planned.folder)
        if record is not None:
            self.records[planned.folder] = record
        return record is not None

    def fly_batch(self, batch: Sequence[PlannedRun]) -> Sequence[PlannedRun]:
        """Fly runs together; returns those that have to fly alone, of which nothing is left.

        Where there is too little memory for all of them, each half flies by itself.
        """
        if len(batch) < 2:
            return batch
        self._require_time()
        flights: list[BatchedFlight] = []
        collectors: list[WindowCollector | None] = []
        for planned in batch:
            assert isinstance(planned.scenario, Scenario)
            collector, monitors = _place_windows(planned)
            flights.append(BatchedFlight(planned.scenario, self._root / planned.folder, planned.in_memory, monitors))
            collectors.append(collector)
        try:
            flown = RunBatch.start(flights)
            flown.execute(on_progress=self._tell_share(len(batch)))
            records = flown.records()
            for planned, collector in zip(batch, collectors, strict=True):
                if collector is not None:
                    write_windows(collector.table(), self._root / planned.folder / WINDOWS_FILE)
        except ShortfallError:
            raise
        except Exception as error:
            raise_if_full(error)
            for flight in flights:
                shutil.rmtree(flight.folder, ignore_errors=True)
            if not isinstance(error, MemoryError):
                return batch
            half = len(batch) // 2
            self.remarks.append(f"{len(batch)} runs did not fit into memory together: each half flew by itself")
            return [*self.fly_batch(batch[:half]), *self.fly_batch(batch[half:])]
        for planned, record in zip(batch, records, strict=True):
            self.records[planned.folder] = record
            if hash64(planned.folder) % CHECKED_SHARE == 0:
                self._check(planned, record)
        self.count(len(batch))
        del flown, flights
        _GARBAGE.add(len(batch))
        return []

    def _check(self, planned: PlannedRun, record: RunRecord) -> None:
        """Fly a run of a batch alone as well: it fails if it is not the same."""
        assert isinstance(planned.scenario, Scenario)
        with tempfile.TemporaryDirectory(prefix="skyrange-check-") as scratch:
            alone = _fly(replace(planned, report=False), planned.scenario, Path(scratch) / "run", None)
            digests = alone.manifest["digests"]
        if digests != record.manifest["digests"]:
            del self.records[planned.folder]
            fingerprints = f"{record.manifest['digests']['fingerprint']} with others, {digests['fingerprint']} alone"
            self.errors[planned.folder] = f"flown in a batch it is another flight than alone: {fingerprints}"

    def fly_alone(self, planned: PlannedRun) -> None:
        """Fly one run."""
        self._require_time()
        assert isinstance(planned.scenario, Scenario)
        try:
            folder = self._root / planned.folder
            self.records[planned.folder] = self._fly_observed(planned, planned.scenario, folder)
        except ShortfallError:  # this process was told to end: the run is flown when the command goes on
            raise
        except SkyrangeError as error:
            raise_if_full(error)
            self.errors[planned.folder] = str(error)
        except Exception as error:  # of a plugin, or of the disk: it must not end the other runs
            raise_if_full(error)
            self.errors[planned.folder] = repr(error)
        self.count(1)
        _GARBAGE.add(1)

    def _fly_observed(self, planned: PlannedRun, scenario: Scenario, folder: Path) -> RunRecord:
        """Fly a run, and tell what happens in it, if somebody wants to know."""
        tell_share, tell_events = self._tell_share(1), self._on_events
        if tell_events is None:
            return _fly(planned, scenario, folder, tell_share)
        collector, due = EventCollector(), 0

        def tell(now: Time, end: Time) -> None:
            nonlocal due
            if now >= due:
                due = now + end // EVENT_REPORTS
                report = collector.take(MAX_STATES)
                if report.states or report.notes or report.tallies:
                    tell_events(planned.folder, report)
            tell_share(now, end)

        return _fly(planned, scenario, folder, tell, collector)

    def _require_time(self) -> None:
        if self._stop is not None and self._stop():
            raise ShortfallError("interrupted between two runs", self._root)

    def _tell_share(self, runs: int) -> OnProgress:
        """The callback of `runs` runs that fly now."""

        def tell(now: Time, end: Time) -> None:
            if self._on_flown is not None:
                self._on_flown(self._flown + runs * min(max(now, 0) / max(end, 1), 1.0))

        return tell


def _find_complete(planned: PlannedRun, scenario: Scenario, folder: Path) -> RunRecord | None:
    """The run if it was flown before, here or where `same_as` says; what is left of an interrupted one is deleted."""
    if folder.exists():
        if planned.same_as is None and (record := _load_complete(planned, scenario, folder)) is not None:
            return record
        shutil.rmtree(folder)
    if planned.same_as is None or _load_complete(planned, scenario, planned.same_as) is None:
        return None
    shutil.copytree(planned.same_as, folder, copy_function=_link)
    return load(folder)


def _load_complete(planned: PlannedRun, scenario: Scenario, folder: Path) -> RunRecord | None:
    try:
        record = load(folder)
    except InputError:
        return None
    manifest = record.manifest
    same = (manifest.get("name"), manifest.get("seed")) == (scenario.name, scenario.seed)
    has_windows = planned.windows is None or (folder / WINDOWS_FILE).is_file()
    return record if manifest["status"] == "complete" and same and has_windows else None


def _link(source: str, target: str) -> None:
    """Take over a file: it is the same on disk where the file system can, else a copy."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _place_windows(planned: PlannedRun) -> tuple[WindowCollector | None, Sequence[MonitorPlacement]]:
    """The collector of the windows of a run, if it collects any, and where it listens."""
    windows = planned.windows
    if windows is None:
        return None, ()
    collector = make_collector(windows.window_s)
    return collector, [place_collector(collector, windows.links, windows.side)]


def _fly(
    planned: PlannedRun, scenario: Scenario, folder: Path, tell: OnProgress | None, *observers: Observer
) -> RunRecord:
    collector, monitors = _place_windows(planned)
    additions = Additions(monitors=monitors, observers=observers)
    record = fly(scenario, folder, report=planned.report, on_progress=tell, additions=additions)
    if collector is not None:
        write_windows(collector.table(), folder / WINDOWS_FILE)
    return record


def raise_if_full(error: BaseException) -> None:
    """Raise `DiskFullError` if an error, or one that it came from, says that nothing more can be written."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT):
            hint = "All finished blocks are kept; free some space, then: skyrange resume"
            raise DiskFullError("study", f"the disk is full: {cause}", hint) from error
        cause = cause.__cause__
