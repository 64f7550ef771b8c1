"""Several runs in parallel: one process per run, with progress and failures reported to the parent.

Each child process has a process group of its own. Ctrl-C therefore reaches only the parent, which forwards it once, so
that every run ends with a complete record. If the system supports it, children are forked, so that plugins registered
in a notebook are known to them.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, NamedTuple

from skyrange.core.errors import ComponentError, InputError, ShortfallError, SkyrangeError
from skyrange.core.time import Time
from skyrange.io.processes.program import end_with_parent
from skyrange.record.schema import LEVELS, keeps
from skyrange.runtime.compilation import fill_cache, is_cold
from skyrange.runtime.interrupt import Interruptible
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.runs import fly


def require_level(scenario: Scenario, table: str, who: str) -> None:
    """Raise `InputError` for `who` if runs of a scenario would not keep a table that it reads."""
    level = scenario.record.level
    if not keeps({"record": {"level": level}}, table):
        enough = [one for one in LEVELS if keeps({"record": {"level": one}}, table)]
        hint = f"It reads the {table} of each run. Add --set record.level={enough[-1]}."
        raise InputError.one(who, "record.level", level, " or ".join(reversed(enough)), hint)


OnRunProgress = Callable[[int, Time, Time], None]
"""Callback for progress: (number of the run, current simulated time, simulated end time)."""

_POLL_S = 0.2
_STEPS = 200  # progress messages per run


class RunResult(NamedTuple):
    """Result of one run: exit code and message of its error, 0 and "" on success."""

    exit_code: int
    message: str


class _Child(NamedTuple):
    number: int
    process: BaseProcess
    inlet: Connection


def run_all(
    flights: Sequence[tuple[Scenario, Path]],
    jobs: int = 2,
    on_progress: OnRunProgress | None = None,
    *,
    report: bool = True,
) -> list[RunResult]:
    """Run every scenario into its folder, `jobs` at a time; returns the results in order.

    Kernels that this version has not compiled yet are compiled first, so that no two runs compile the same.
    Ctrl-C ends the active runs; the remaining ones do not start and get the exit code of a shortfall.
    """
    if jobs <= 1 or len(flights) <= 1:
        return _run_in_turn(flights, on_progress, report=report)
    forks = "fork" in multiprocessing.get_all_start_methods()
    context: Any = multiprocessing.get_context("fork" if forks else "spawn")
    results: list[RunResult | None] = [None] * len(flights)
    waiting = list(range(len(flights)))
    children: dict[Connection, _Child] = {}
    flying: set[int] = set()
    signalled: set[int] = set()
    if is_cold():
        fill_cache(jobs)
    with Interruptible() as interrupt:
        try:
            while children or (waiting and not interrupt.requested):
                while waiting and len(children) < jobs and not interrupt.requested:
                    number = waiting.pop(0)
                    inlet, outlet = context.Pipe(duplex=False)
                    scenario, folder = flights[number]
                    arguments = (outlet, scenario, folder, os.getpid())
                    process = context.Process(
                        target=_child_main, args=arguments, kwargs={"report": report}, daemon=True
                    )
                    process.start()
                    outlet.close()
                    children[inlet] = _Child(number, process, inlet)
                if interrupt.requested:
                    # one that has not begun to fly would lose a signal: it is told when it has
                    due = [child for child in children.values() if child.number in flying - signalled]
                    signalled.update(child.number for child in due)
                    _interrupt(due)
                for ready in wait(list(children), timeout=_POLL_S):
                    assert isinstance(ready, Connection)
                    flying.add(children[ready].number)
                    _handle_message(children, ready, results, on_progress)
        finally:
            for child in children.values():
                child.process.terminate()
    return [RunResult(ShortfallError.exit_code, "not flown: interrupted") if one is None else one for one in results]


def _handle_message(
    children: dict[Connection, _Child],
    inlet: Connection,
    results: list[RunResult | None],
    on_progress: OnRunProgress | None,
) -> None:
    """Handle one message of a child: its progress, its result, or the end of its process."""
    child = children[inlet]
    try:
        message = inlet.recv()
    except (EOFError, OSError):
        child.process.join()
        del children[inlet]
        inlet.close()
        if results[child.number] is None:
            reason = f"the process of the run ended with code {child.process.exitcode}"
            results[child.number] = RunResult(ComponentError.exit_code, reason)
        return
    if isinstance(message, RunResult):
        results[child.number] = message
    elif on_progress is not None:
        on_progress(child.number, *message)


def _interrupt(children: Iterable[_Child]) -> None:
    for child in children:
        if child.process.is_alive() and child.process.pid is not None:
            os.kill(child.process.pid, signal.SIGINT)


def _run_in_turn(
    flights: Sequence[tuple[Scenario, Path]], on_progress: OnRunProgress | None, *, report: bool
) -> list[RunResult]:
    results: list[RunResult] = []
    for number, (scenario, folder) in enumerate(flights):
        if any(one.exit_code == ShortfallError.exit_code for one in results):
            results.append(RunResult(ShortfallError.exit_code, "not flown: interrupted"))
            continue
        results.append(_run_guarded(scenario, folder, _numbered_progress(number, on_progress), report=report))
    return results


def _numbered_progress(number: int, on_progress: OnRunProgress | None) -> Callable[[Time, Time], None] | None:
    return None if on_progress is None else lambda now, end: on_progress(number, now, end)


def _run_guarded(
    scenario: Scenario, folder: Path, on_progress: Callable[[Time, Time], None] | None, *, report: bool
) -> RunResult:
    try:
        fly(scenario, folder, report=report, on_progress=on_progress)
    except SkyrangeError as error:
        return RunResult(error.exit_code, str(error))
    except OSError as error:
        return RunResult(ComponentError.exit_code, str(error))
    return RunResult(0, "")


def _child_main(outlet: Connection, scenario: Scenario, folder: Path, parent: int, *, report: bool) -> None:
    """Main function of a child process, which ends with its parent."""
    end_with_parent(parent)
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)
    last = -1

    def tell(now: Time, end: Time) -> None:
        nonlocal last
        step = _STEPS * now // max(end, 1)
        if step > last:
            last = step
            outlet.send((now, end))

    outlet.send(_run_guarded(scenario, folder, tell, report=report))
    outlet.close()
