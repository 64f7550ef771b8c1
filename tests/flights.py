"""Flights that tests share: each is flown once in a run of pytest, by the first test of any worker that asks for it.

A flight is known by what is flown: the text of its scenario, its seed among it, and how it was flown. Its folder is
read by all and written by none (`tests.flight_folder`).
"""

from __future__ import annotations

import fcntl
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path

from skyrange.analysis import Pair, load_pair
from skyrange.record import RunRecord, load
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load as load_scenario
from skyrange.study.pairing import pair
from skyrange.study.runs import fly
from skyrange.twins.arms import ATTACKED
from tests.flight_folder import find_folder, seal
from tests.processor_time import CLOCK


def shared_run(scenario: Scenario | str, *changes: str) -> RunRecord:
    """The record of a scenario, or of a shipped one with `changes`, without a report. Read it only."""
    flown = _resolved(scenario, changes)
    return load(_flown("run", flown, lambda folder: fly(flown, folder, report=False)))


def shared_pair(scenario: Scenario | str, *changes: str) -> Pair:
    """A scenario with attacks beside its twins, as `skyrange pair` flies it by default. Read it only."""
    flown = _resolved(scenario, changes)

    def make(folder: Path) -> None:
        attacked = shared_run(flown).path
        pair(flown, folder, jobs=1, run_reports=False, known={(ATTACKED, flown.seed): attacked})

    return load_pair(_flown("pair", flown, make))


def shared_folder(name: str, make: Callable[[Path], object]) -> Path:
    """What `make` writes into a folder, made once in a run of pytest under `name`. Read it only, or copy it."""
    return _made_once(find_folder() / name, make)


def _resolved(scenario: Scenario | str, changes: tuple[str, ...]) -> Scenario:
    if isinstance(scenario, str):
        return load_scenario(scenario, changes)
    assert not changes, "changes apply to a shipped scenario's name"
    return scenario


def _flown(how: str, scenario: Scenario, make: Callable[[Path], object]) -> Path:
    """The folder of a flight, made now if no test has asked for it before."""
    key = blake2b(f"{how} {scenario.model_dump_json()}".encode(), digest_size=12).hexdigest()
    return _made_once(find_folder() / f"{scenario.name}-{how}-{key}", make)


def _made_once(folder: Path, make: Callable[[Path], object]) -> Path:
    with _locked(folder.parent / f"{folder.name}.lock"):
        if not folder.exists():
            new = folder.parent / f"{folder.name}.new"
            shutil.rmtree(new, ignore_errors=True)  # of a worker that died
            with CLOCK.timed("shared"):
                make(new)
            seal(new, folder)
    return folder


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    with path.open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # released when the file is closed or its process has died
        yield
