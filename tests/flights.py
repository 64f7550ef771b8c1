"""Flights that tests share: each is flown once in a run of pytest, by the first test of any worker that asks for it.

A flight is known by what is flown: the text of its scenario, its seed among it, and how it was flown. Its folder is
read by all and written by none; the end of the run of pytest checks that.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path

import pytest

from skyrange.analysis import Pair, load_pair
from skyrange.record import RunRecord, load
from skyrange.runtime.warm_up import warm_up
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load as load_scenario
from skyrange.study.attribution.arms import ATTACKED
from skyrange.study.pairing import pair
from skyrange.study.runs import fly
from skyrange.study.sweep.execution import study_run
from tests.processor_time import CLOCK

FOLDER = "SKYRANGE_TEST_FLIGHTS"
"""The environment variable that names the folder of the shared flights."""


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


def _resolved(scenario: Scenario | str, changes: tuple[str, ...]) -> Scenario:
    if isinstance(scenario, str):
        return load_scenario(scenario, changes)
    assert not changes, "changes apply to a shipped scenario's name"
    return scenario


def _flown(how: str, scenario: Scenario, make: Callable[[Path], object]) -> Path:
    """The folder of a flight, made now if no test has asked for it before."""
    key = blake2b(f"{how} {scenario.model_dump_json()}".encode(), digest_size=12).hexdigest()
    home = Path(os.environ[FOLDER])
    folder = home / f"{scenario.name}-{how}-{key}"
    with _locked(home / f"{folder.name}.lock"):
        if not folder.exists():
            new = home / f"{folder.name}.new"
            shutil.rmtree(new, ignore_errors=True)  # of a worker that died
            with CLOCK.timed("shared"):
                make(new)
            (home / f"{folder.name}.json").write_text(json.dumps(_listing(new)))
            new.rename(folder)
    return folder


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    with path.open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # released when the file is closed or its process has died
        yield


def _listing(folder: Path) -> dict[str, list[int]]:
    """Size and time of change of each file."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(path.relative_to(folder)): [path.stat().st_size, path.stat().st_mtime_ns] for path in files}


@pytest.fixture(scope="session", autouse=True)
def studies_warm_up_once() -> Iterator[None]:
    """Let the first study of this process alone load the compiled functions before it forks its workers."""
    warm = False

    def warm_up_once(scenario: Scenario) -> None:
        nonlocal warm
        if not warm:
            with CLOCK.timed("shared"):
                warm_up(scenario)
        warm = True

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(study_run, "warm_up", warm_up_once)
        yield


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        folder = tempfile.mkdtemp(prefix="skyrange-flights-")
        os.environ[FOLDER] = folder  # workers of xdist are started with it
        config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workerinput"):
        return
    home = Path(os.environ[FOLDER])
    for path in sorted(home.glob("*.json")):
        folder = home / path.stem
        if json.loads(path.read_text()) != _listing(folder):
            raise pytest.UsageError(f"a test wrote to the shared flight {folder.name}; it has to copy it first")
