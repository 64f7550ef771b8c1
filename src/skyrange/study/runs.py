"""Running a scenario from Python: the run's record, with its report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from skyrange.assembly.build import NOTHING_MORE, Additions
from skyrange.contracts.components import Observer
from skyrange.contracts.links import Act, TapPlacement
from skyrange.contracts.monitors import MonitorPlacement
from skyrange.core.errors import ShortfallError
from skyrange.core.time import Time
from skyrange.record import RunRecord, load
from skyrange.runtime.cores.core import ApproachError
from skyrange.runtime.cores.division import Division, divide
from skyrange.runtime.cores.run import run_on_cores
from skyrange.runtime.pace import Pace
from skyrange.runtime.run import OnProgress, Run
from skyrange.runtime.viewers import Viewers
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load as load_scenario


def fly(
    scenario: Scenario,
    out: Path | None = None,
    *,
    additions: Additions = NOTHING_MORE,
    speed: float | None = None,
    viewers: Viewers | None = None,
    on_progress: OnProgress | None = None,
    report: bool = True,
    motion: bool = False,
    cores: int = 1,
    on_notice: Callable[[str], None] | None = None,
    on_start: Callable[[Run], None] | None = None,
    real_time: bool = False,
) -> RunRecord:
    """Run `scenario` into the folder `out`, or into the first free folder `runs/NAME`, `runs/NAME-2` …, with a report
    unless its record is a summary.

    `speed` is that of `Run.execute`. Without it, a run with viewers or `real_time` runs in real time, or at the pace of
    engines that have one, and any other run as fast as possible. `viewers` are served between steps; the caller
    closes them.
    `additions` and `motion` are those of `Run.start`. The run has at most `cores` cores, with the same digests; why it
    uses fewer is in the manifest, and is told to `on_notice`. `on_start` gets the run before its first instant. Raises
    the errors of `Run.execute`; after a
    `ShortfallError` (Ctrl-C) the report is written as well.
    """
    pace = 0.0 if speed is None else speed
    Pace(pace)  # rejects an invalid speed before a folder is created
    more: dict[str, Any] = {}
    if cores > 1:
        observed = additions != NOTHING_MORE or viewers is not None or on_start is not None or motion
        folder, reason = _fly_on_cores(
            scenario,
            out,
            cores,
            speed=pace,
            observed=observed,
            on_progress=on_progress,
            on_notice=on_notice,
            report=report,
        )
        if folder is not None:
            return _report(folder) if report else load(folder)
        more = {"cores": {"asked": cores, "used": 1, "reason": reason}}
    if viewers is not None:
        additions = replace(additions, observers=[*additions.observers, viewers])
        on_progress = _serving(viewers, on_progress)
    run = Run.start(scenario, out, additions=additions, speed=pace, fuse=viewers is None, motion=motion, more=more)
    if speed is None and (viewers is not None or real_time) and not run.on_wall_clock:
        pace = 1.0
    folder = run.recorder.path
    if on_start is not None:
        on_start(run)
    try:
        run.execute(speed=pace, on_progress=on_progress)
    except ShortfallError:
        if report:
            _report(folder)
        raise
    return _report(folder) if report else load(folder)


def _fly_on_cores(
    scenario: Scenario, out: Path | None, cores: int, *, speed: float, observed: bool, on_progress: OnProgress | None,
    on_notice: Callable[[str], None] | None, report: bool,
) -> tuple[Path | None, str]:  # fmt: skip
    """Run `scenario` on several cores: its folder, or None and why it has to run on one; `observed` if something that
    is passed from Python, or a viewer, has to see all of it.
    """
    undivided = Division((), "what is passed to the run, or watches it, has to see all of it")
    division = undivided if observed else divide(scenario, cores)
    if division.reason and on_notice is not None:
        on_notice(f"using {max(division.cores, 1)} of {cores} cores: {division.reason}")
    if division.cores < 2:
        return None, division.reason
    try:
        return run_on_cores(scenario, division, cores, out, speed=speed, on_progress=on_progress), ""
    except ShortfallError as error:
        if report:
            _report(error.path)
        raise
    except ApproachError as error:
        if on_notice is not None:
            on_notice(f"{error}; the run starts again on one core")
        return None, str(error)


def _serving(viewers: Viewers, on_progress: OnProgress | None) -> OnProgress:
    def between(now: Time, end: Time) -> None:
        viewers.serve()
        if on_progress is not None:
            on_progress(now, end)

    return between


def _report(folder: Path) -> RunRecord:
    from skyrange.report import write_report

    record = load(folder)
    if record.keeps("truth"):  # what a summary can tell, `show` does
        write_report(record, folder / "report.html")
    return record


def run(
    scenario: Scenario | str | Path,
    out: str | Path | None = None,
    *,
    seed: int | None = None,
    speed: float = 0.0,
    buildings: str | Path | None = None,
    changes: Sequence[str] = (),
    taps: Sequence[TapPlacement] = (),
    acts: Sequence[Act] = (),
    monitors: Sequence[MonitorPlacement] = (),
    observers: Sequence[Observer] = (),
    viewers: Viewers | None = None,
    on_progress: OnProgress | None = None,
    motion: bool = False,
    cores: int = 1,
) -> RunRecord:
    """Run a scenario and return its record; the Python equivalent of `skyrange run`.

    `scenario` is a `Scenario`, the name of a shipped scenario, or a TOML file. `out` defaults to the first free folder
    of `runs/<name>`, `runs/<name>-2` … `seed`, `buildings` and `changes` (`path=value`, as for `--set`) apply to names
    and files; a `Scenario` is run unchanged. `taps`, `acts` and `monitors` are placed on links by name or pattern.
    `observers` (`contracts.components.Observer`) see every frame, note, label and tick, and alter nothing. `viewers`
    (`runtime.viewers.Viewers`) let ground stations watch, preferably at `speed` 1. `motion` is `--allow-motion`:
    together with the scenario's `allow_motion` it lets external vehicles move. `cores` is how many processor cores it
    may use.
    """
    if isinstance(scenario, Scenario):
        if seed is not None or buildings is not None or changes:
            raise TypeError("seed, buildings and changes apply to a scenario's name or file; a Scenario holds its own")
    else:
        scenario = load_scenario(scenario, changes, seed=seed, buildings=buildings)
    folder = Path(out) if out is not None else None
    return fly(
        scenario,
        folder,
        additions=Additions(taps, acts, monitors, observers),
        speed=speed,
        viewers=viewers,
        on_progress=on_progress,
        motion=motion,
        cores=cores,
    )
