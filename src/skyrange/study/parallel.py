"""How do several runs fly at once? A process each, so many at a time, with their progress and their failures told here.

Children are in a process group of their own: Ctrl-C reaches the parent alone, which passes it on once, and every run
ends whole. Where the system can, children are forks, which know the plugins that a notebook has registered.
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

from skyrange.core.compiled import compiled_before
from skyrange.core.errors import ComponentError, ShortfallError, SkyrangeError
from skyrange.core.time import Time
from skyrange.runtime.interrupt import Interruptible
from skyrange.scenario.schema import Scenario
from skyrange.study.session import fly

OnShare = Callable[[int, Time, Time], None]
"""Called with (number of the flight, simulated now, simulated end) as flights go on."""

_LOOK_S = 0.2
_STEPS = 200  # messages that a flight sends of its progress


class Flown(NamedTuple):
    """What came of one flight: its error's exit code and words, 0 and "" where there was none."""

    code: int
    words: str


class _Child(NamedTuple):
    number: int
    process: BaseProcess
    inlet: Connection


def fly_all(
    flights: Sequence[tuple[Scenario, Path]], jobs: int = 2, on_progress: OnShare | None = None, report: bool = True
) -> list[Flown]:
    """Fly every scenario into its folder, `jobs` at a time; returns what came of each, in order.

    Where no kernel was compiled before, the first flies alone: what it compiles the others find. Ctrl-C ends those
    that fly, and the others do not start: their code is that of a shortfall.
    """
    if jobs <= 1 or len(flights) <= 1:
        return _one_by_one(flights, on_progress, report)
    forks = "fork" in multiprocessing.get_all_start_methods()
    context: Any = multiprocessing.get_context("fork" if forks else "spawn")
    results: list[Flown | None] = [None] * len(flights)
    waiting = list(range(len(flights)))
    children: dict[Connection, _Child] = {}
    flying: set[int] = set()
    told: set[int] = set()
    cold = not compiled_before()
    with Interruptible() as interrupt:
        try:
            while children or (waiting and not interrupt.requested):
                most = 1 if cold and not any(results) else jobs
                while waiting and len(children) < most and not interrupt.requested:
                    number = waiting.pop(0)
                    inlet, outlet = context.Pipe(duplex=False)
                    scenario, folder = flights[number]
                    process = context.Process(target=_fly, args=(outlet, scenario, folder, report), daemon=True)
                    process.start()
                    outlet.close()
                    children[inlet] = _Child(number, process, inlet)
                if interrupt.requested:
                    # one that has not begun to fly would lose a signal: it is told when it has
                    due = [child for child in children.values() if child.number in flying - told]
                    told.update(child.number for child in due)
                    _interrupt(due)
                for ready in wait(list(children), timeout=_LOOK_S):
                    assert isinstance(ready, Connection)
                    flying.add(children[ready].number)
                    _hear(children, ready, results, on_progress)
        finally:
            for child in children.values():
                child.process.terminate()
    return [Flown(ShortfallError.exit_code, "not flown: interrupted") if one is None else one for one in results]


def _hear(
    children: dict[Connection, _Child], inlet: Connection, results: list[Flown | None], on_progress: OnShare | None
) -> None:
    """Take one message of a child: its progress, what came of it, or that it is gone."""
    child = children[inlet]
    try:
        message = inlet.recv()
    except (EOFError, OSError):
        child.process.join()
        del children[inlet]
        inlet.close()
        if results[child.number] is None:
            words = f"the process of the flight ended with code {child.process.exitcode}"
            results[child.number] = Flown(ComponentError.exit_code, words)
        return
    if isinstance(message, Flown):
        results[child.number] = message
    elif on_progress is not None:
        on_progress(child.number, *message)


def _interrupt(children: Iterable[_Child]) -> None:
    for child in children:
        if child.process.is_alive() and child.process.pid is not None:
            os.kill(child.process.pid, signal.SIGINT)


def _one_by_one(flights: Sequence[tuple[Scenario, Path]], on_progress: OnShare | None, report: bool) -> list[Flown]:
    results: list[Flown] = []
    for number, (scenario, folder) in enumerate(flights):
        if any(one.code == ShortfallError.exit_code for one in results):
            results.append(Flown(ShortfallError.exit_code, "not flown: interrupted"))
            continue
        results.append(_flown(scenario, folder, report, _share(number, on_progress)))
    return results


def _share(number: int, on_progress: OnShare | None) -> Callable[[Time, Time], None] | None:
    return None if on_progress is None else lambda now, end: on_progress(number, now, end)


def _flown(scenario: Scenario, folder: Path, report: bool, on_progress: Callable[[Time, Time], None] | None) -> Flown:
    try:
        fly(scenario, folder, report=report, on_progress=on_progress)
    except SkyrangeError as error:
        return Flown(error.exit_code, str(error))
    except OSError as error:
        return Flown(ComponentError.exit_code, str(error))
    return Flown(0, "")


def _fly(outlet: Connection, scenario: Scenario, folder: Path, report: bool) -> None:
    """A child's whole life."""
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)
    last = -1

    def tell(now: Time, end: Time) -> None:
        nonlocal last
        step = _STEPS * now // max(end, 1)
        if step > last:
            last = step
            outlet.send((now, end))

    outlet.send(_flown(scenario, folder, report, tell))
    outlet.close()
