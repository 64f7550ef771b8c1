"""Progress of runs and downloads: a bar on a terminal, occasional lines elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

from skyrange.cli.output.console import print_notice, terminal
from skyrange.core.time import Time, to_seconds

OnProgress = Callable[[Time, Time], None]
OnRunProgress = Callable[[int, Time, Time], None]
OnBytes = Callable[[int, int | None], None]
OnStep = Callable[[str, int, int], None]
OnMapProgress = Callable[[int, int, float | None], None]


@contextmanager
def progress(name: str, *, quiet: bool) -> Iterator[OnProgress | None]:
    """Yield the progress callback for `fly`. It writes to standard error, so that output can be piped."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        name_column, time_column = TextColumn("{task.description}", markup=False), TextColumn("{task.fields[at]}")
        columns = (
            name_column,
            BarColumn(),
            time_column,
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=terminal(stderr=True), transient=True) as bar:
            task = bar.add_task(name, total=None, at="starting")

            def show(now: Time, end: Time) -> None:
                time_column = f"{to_seconds(now):.0f} of {to_seconds(end):.0f} s" if now < end else "writing the record"
                if now < 0:
                    time_column = f"autopilots boot, {-to_seconds(now):.0f} simulated s left"
                bar.update(task, total=end, completed=max(now, 0), at=time_column)

            yield show
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

        yield tell


@contextmanager
def parallel_progress(name: str, flights: int, *, quiet: bool) -> Iterator[OnRunProgress | None]:
    """Yield a progress callback for several parallel runs, with one bar or line for all of them."""
    with progress(f"{name}, {flights} runs", quiet=quiet) as show:
        if show is None:
            yield None
            return
        reached = [0] * flights

        def tell(number: int, now: Time, end: Time) -> None:
            reached[number] = max(reached[number], now)
            show(sum(reached), end * flights)

        yield tell


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

            def show(what: str, done: int, steps: int) -> None:
                bar.update(task, description=what, total=steps, completed=done)

            yield show
    else:
        shown = ""

        def tell(what: str, done: int, steps: int) -> None:
            nonlocal shown
            if what != shown:
                print_notice(what)
            shown = what

        yield tell


@contextmanager
def map_progress(name: str, unit: str, *, quiet: bool) -> Iterator[OnMapProgress | None]:
    """Yield a progress callback for steps of about equal length: how many are done, of how many, and the seconds left
    if they are known.
    """
    if quiet:
        yield None
    elif sys.stderr.isatty():
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        said, at = TextColumn("{task.description}", markup=False), TextColumn("{task.fields[at]}")
        columns = (said, BarColumn(), at, TimeElapsedColumn())
        with Progress(*columns, console=terminal(stderr=True), transient=True) as bar:
            task = bar.add_task(name, total=None, at="starting")

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
    from skyrange.runtime.compilation import fill_cache

    with map_progress("compiling", "kernels", quiet=quiet) as show:
        return fill_cache(jobs, None if show is None else lambda done, total: show(done, total, None))


def compile_if_cold(*, quiet: bool) -> None:
    """Compile kernels before a flight if this version has not done so. What an edit changes is compiled in flight."""
    from skyrange.runtime.compilation import is_cold

    if is_cold():
        compile_kernels(quiet=quiet)


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} min"
