"""Are flights that tests share flown once, whole, and left as they are?"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from skyrange.record import RunRecord
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.runs import fly
from tests import flight_folder, flights
from tests.flights import shared_run

SHORT = "duration_s=1"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of shared flights."""
    monkeypatch.setenv("SKYRANGE_TEST_FLIGHTS", str(tmp_path))
    return tmp_path


def test_a_flight_is_flown_once_and_another_seed_is_another_flight(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = shared_run("squares", SHORT)
    flown: list[str] = []

    def counted(scenario: Scenario, *words: Any, **named: Any) -> RunRecord:
        flown.append(scenario.name)
        return fly(scenario, *words, **named)

    monkeypatch.setattr(flights, "fly", counted)
    again = shared_run("squares", SHORT)
    assert (again.path, flown) == (first.path, [])
    other = shared_run("squares", SHORT, "seed=99")
    assert other.path != first.path
    assert other.manifest["digests"] != first.manifest["digests"]
    assert flown == ["squares"]


def test_a_flight_that_failed_is_flown_anew_by_the_next_one(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(scenario: object, path: Path, report: bool) -> None:
        path.mkdir()
        (path / "half").write_text("x")
        raise OSError("no space")

    with monkeypatch.context() as patch:
        patch.setattr(flights, "fly", fail)
        with pytest.raises(OSError, match="no space"):
            shared_run("squares", SHORT)
    assert not (shared_run("squares", SHORT).path / "half").exists()


def test_a_test_that_writes_to_a_flight_is_told(folder: Path, pytestconfig: pytest.Config) -> None:
    class Session:
        class config:  # noqa: N801
            """Of the process that starts the workers."""

    record = shared_run("squares", SHORT)
    flight_folder.pytest_sessionfinish(Session())  # type: ignore[arg-type]
    shutil.copytree(record.path, folder / "copy")
    flight_folder.pytest_sessionfinish(Session())  # type: ignore[arg-type]
    (record.path / "scenario.toml").write_text("changed")
    with pytest.raises(pytest.UsageError, match=f"a test wrote to the shared flight {record.path.name}"):
        flight_folder.pytest_sessionfinish(Session())  # type: ignore[arg-type]
