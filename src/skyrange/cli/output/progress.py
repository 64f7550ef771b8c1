"""Progress of runs and downloads: a bar on a terminal, occasional lines elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import TYPE_CHECKING, NamedTuple

from skyrange.cli.output.console import print_notice, terminal
from skyrange.core.time import Time, to_seconds

if TYPE_CHECKING:
    from skyrange.contracts.components import Observer
    from skyrange.study.execution.plan_run import OnPlanProgress, PlanProgress

OnProgress = Callable[[Time, Time], None]
OnBytes = Callable[[int, int | None], None]
OnStep = Callable[[str, int, int], None]
OnMapProgress = Callable[[int, int, float | None], None]


class FlightProgress(NamedTuple):
    """What shows the progress of a flight: both are for `fly`."""

    on_progress: OnProgress | None = None
    observers: tuple[Observer, ...] = ()


@contextmanager
def progress(name: str, *, quiet: bool) -> Iterator[OnProgress | None]:
    """Yield the progress callback for `fly`. It writes to standard error, so that output can be piped."""
    with flight_progress(name, 0, quiet=quiet, observed=False) as shown:
        yield shown.on_progress


@contextmanager
def flight_progress(name: str, aircraft: int, *, quiet: bool, observed: bool = True) -> Iterator[FlightProgress]:
    """Yield what shows the progress of a run with so many aircraft: as `progress`, and on a terminal also what happens,
    below the bar, unless the run cannot be `observed`.
    """
    if quiet:
        yield FlightProgress()
    elif sys.stderr.isatty():
        from skyrange.cli.output.flight_bar import REFRESH_HZ, FlightBar
        from skyrange.cli.output.flight_lines import FlightLines
        from skyrange.runtime.compilation.in_flight import watch_compilations
        from skyrange.runtime.event_reports import EventCollector

        collector, lines, drawn_s = EventCollector(), FlightLines(aircraft), 0.0
        with watch_compilations() as compilations, FlightBar(name, compilations, terminal(stderr=True)) as bar:

            def show(now: Time, end: Time) -> None:
                nonlocal drawn_s
                if now < end and monotonic() < drawn_s + 1.0 / REFRESH_HZ:
                    return
                drawn_s = monotonic()
                if observed:
                    lines.add(collector.take())
                    bar.lines = lines.render()
                at = f"{to_seconds(now):.0f} of {to_seconds(end):.0f} s" if now < end else "writing the record"
                if now < 0:
                    at = f"autopilots boot, {-to_seconds(now):.0f} simulated s left"
                bar.show(at, done=max(now, 0), total=end)

            yield FlightProgress(show, (collector,) if observed else ())
    else:
        tenth = -1
        boot: tuple[float, Time] | None = None

        def tell(now: Time, end: Time) -> None:
            nonlocal tenth, boot
            if now < 0:
                if boot is None:
                    boot = monotonic(), now
                    print_notice(f"{name}: autopilots boot for {-to_seconds(now):.0f} simulated s")
                return
            if boot is not None:
                share = (monotonic() - boot[0]) / -to_seconds(boot[1])
                pace = f"{share:.1f} s per simulated second, at this pace {share * to_seconds(end):.0f} s for the run"
                print_notice(f"{name}: autopilots booted in {pace}")
                boot = None
            reached = 10 * now // max(end, 1)
            if reached > tenth:
                tenth = reached
                print_notice(f"{name}: {to_seconds(now):.0f} of {to_seconds(end):.0f} s")

        yield FlightProgress(tell)


@contextmanager
def run_progress(name: str, *, quiet: bool) -> Iterator[OnPlanProgress | None]:
    """Yield a progress callback for the runs of a plan, with one bar or line for all of them."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

        from skyrange.cli.output.flight_bar import LinedProgress
        from skyrange.cli.output.flight_lines import GroupLines

        description, at = TextColumn("{task.description}", markup=False), TextColumn("{task.fields[at]}")
        columns = (description, BarColumn(), at, TimeElapsedColumn())
        with LinedProgress(*columns, console=terminal(stderr=True), transient=True) as bar:
            task = bar.add_task(name, total=None, at="starting")

            remarked, lines = 0, GroupLines()

            def show(status: PlanProgress) -> None:
                nonlocal remarked
                remarked = _print_remarks(name, status, remarked)
                left = "" if status.left_s is None else f", {_minutes(status.left_s)} left"
                done = status.finished + status.under_way
                at = f"{status.finished} of {status.runs} runs{left}"
                bar.update(task, total=status.runs, completed=done, at=at)
                bar.lines = lines.render(status.groups, status.events)

            yield show
    else:
        tenth, ended, remarked = -1, False, 0

        def tell(status: PlanProgress) -> None:
            nonlocal tenth, ended, remarked
            remarked = _print_remarks(name, status, remarked)
            share = (status.finished + status.under_way) / max(status.runs, 1)
            if int(10 * share) > tenth or (status.finished == status.runs and not ended):
                tenth, ended = int(10 * share), status.finished == status.runs
                left = (
                    "" if status.left_s is None or ended else f", {100 * share:.0f} %, {_minutes(status.left_s)} left"
                )
                print_notice(f"{name}: {status.finished} of {status.runs} runs{left}")

        yield tell


def _print_remarks(name: str, status: PlanProgress, printed: int) -> int:
    """Print the remarks after those that were printed; how many are printed now."""
    for remark in status.remarks[printed:]:
        print_notice(f"{name}: {remark}")
    return len(status.remarks)


@contextmanager
def download_progress(name: str, *, quiet: bool) -> Iterator[OnBytes | None]:
    """Yield a progress callback for a download: bytes done, and the total if it is known."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

        columns = (TextColumn("{task.description}", markup=False), BarColumn(), DownloadColumn(), TransferSpeedColumn())
        with Progress(*columns, console=terminal(stderr=True), transient=True) as bar:
            task = bar.add_task(name, total=None)
            yield lambda done, total: bar.update(task, total=total, completed=done)
    else:
        quarter = -1

        def tell(done: int, total: int | None) -> None:
            nonlocal quarter
            reached = 4 * done // total if total else done >> 22
            if reached > quarter:
                quarter = reached
                of = f" of {total / 1e6:.1f}" if total else ""
                print_notice(f"{name}: {done / 1e6:.1f}{of} MB")

        yield tell


@contextmanager
def step_progress(*, quiet: bool) -> Iterator[OnStep | None]:
    """Yield a progress callback for work in steps: what is being done, steps of it that are done, and all its steps."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
        with Progress(*columns, console=terminal(stderr=True), transient=True) as bar:
            task = bar.add_task("starting", total=None)

            def show(step: str, done: int, steps: int) -> None:
                bar.update(task, description=step, total=steps, completed=done)

            yield show
    else:
        shown = ""

        def tell(step: str, done: int, steps: int) -> None:
            nonlocal shown
            if step != shown:
                print_notice(step)
            shown = step

        yield tell


@contextmanager
def map_progress(name: str, unit: str, *, quiet: bool, title: str = "") -> Iterator[OnMapProgress | None]:
    """Yield a progress callback for steps of about equal length: how many are done, of how many, and the seconds left
    if they are known. A terminal shows the `title` instead of the name.
    """
    if quiet:
        yield None
    elif sys.stderr.isatty():
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        description, at = TextColumn("{task.description}", markup=False), TextColumn("{task.fields[at]}")
        columns = (description, BarColumn(), at, TimeElapsedColumn())
        with Progress(*columns, console=terminal(stderr=True), transient=True) as bar:
            task = bar.add_task(title or name, total=None, at="starting")

            def show(done: int, total: int, left_s: float | None) -> None:
                left = "" if left_s is None else f", {_minutes(left_s)} left"
                bar.update(task, total=total, completed=done, at=f"{done} of {total} {unit}{left}")

            yield show
    else:
        tenth, estimated = -1, False

        def tell(done: int, total: int, left_s: float | None) -> None:
            nonlocal tenth, estimated
            reached = 10 * done // max(total, 1)
            if reached > tenth or (left_s is not None and not estimated):
                tenth, estimated = reached, left_s is not None
                left = "" if left_s is None else f", about {_minutes(left_s)} left"
                print_notice(f"{name}: {done} of {total} {unit}{left}")

        yield tell


def compile_kernels(jobs: int | None = None, *, quiet: bool) -> int:
    """Compile the kernels that flights use and the cache lacks, with progress; returns their number."""
    from skyrange.cli.output.flight_bar import COMPILING
    from skyrange.runtime.compilation import fill_cache

    with map_progress("compiling", "kernels", quiet=quiet, title=COMPILING) as show:
        return fill_cache(jobs, None if show is None else lambda done, total: show(done, total, None))


def compile_if_cold(*, quiet: bool) -> None:
    """Compile kernels before a flight if this version has not done so. What an edit changes is compiled in flight."""
    from skyrange.runtime.compilation import is_cold

    if is_cold():
        compile_kernels(quiet=quiet)


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} min"
