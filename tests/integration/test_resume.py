"""Commands that fly many runs, killed and gone on with: what was finished is not flown again, and nothing is lost."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.core.errors import ComponentError, InputError, ShortfallError
from skyrange.study.execution import flight, store
from skyrange.study.execution.executors import Flights, InThisProcess
from skyrange.study.execution.store import open_store
from skyrange.study.runs import fly
from skyrange.twins.pair_folder import load_pair

STUDY = """
name = "jumps"
scenario = "gnss.jump"
changes = ["duration_s=4", "attacks.jump.start_s=3"]
seeds = 3
"""
MATRIX = """
name = "small"
seeds = 3
columns = [{ id = "gate", defences = [{ kind = "gnss.innovation" }] }]
[[rows]]
id = "jump"
scenario = "gnss.jump"
measure = "strayed_m"
changes = ["duration_s=4", "attacks.jump.start_s=3"]
"""
SHORT = ("--set", "duration_s=4", "--set", "attacks.jump.start_s=3", "--seeds", "3")
COMMANDS = {
    "pair": ["pair", "gnss.jump", *SHORT],
    "compare": ["compare", "gnss.jump", "--variant", "far:attacks.jump.params.offset_m=[30,0,0]", *SHORT],
    "matrix": ["matrix", "matrix.toml"],
    "study": ["study", "run", "study.toml"],
}


def results_of(folder: Path) -> Any:
    """What a command found, without what differs from run to run by the wall clock."""
    for name in ("pair.json", "comparison.json", "matrix.json"):
        if (folder / name).is_file():
            tables = [pq.read_table(path).to_pylist() for path in sorted(folder.glob("*.parquet"))]
            return json.loads((folder / name).read_text()), tables
    return {path.name: pq.read_table(path).to_pylist() for path in (folder / "results").rglob("*.parquet")}


def kill_when_begun(command: list[str], folder: Path) -> dict[str, int]:
    """Kill a command with SIGKILL when a block is finished; returns when each finished one was written, by name."""
    arguments = ([*command, "--jobs", "2", "--out", str(folder), "--json"],)
    process = multiprocessing.get_context("fork").Process(target=app, args=arguments, kwargs={"standalone_mode": False})
    process.start()
    assert process.pid is not None
    deadline = time.monotonic() + 120.0
    while time.monotonic() < deadline and not any(folder.glob("blocks/**/*.json")) and process.is_alive():
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline:  # its workers end with it
        try:
            with open_store(folder).lock():
                break
        except InputError:
            time.sleep(0.01)
    return {str(path): path.stat().st_mtime_ns for path in folder.glob("blocks/**/*.json")}


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_killed_command_goes_on_without_flying_finished_runs_again(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("study.toml").write_text(STUDY)
    Path("matrix.toml").write_text(MATRIX)
    folder, command = tmp_path / "killed", COMMANDS[name]
    before = kill_when_begun(command, folder)
    blocks = open_store(folder).manifest["blocks"]
    assert 0 < len(before) < blocks
    kept = {str(path): path.stat().st_mtime_ns for path in folder.rglob("manifest.json")}
    whole = {path for path in kept if '"status": "complete"' in Path(path).read_text()}
    again = CliRunner().invoke(app, [*command, "--jobs", "2", "--out", str(folder), "--json"])
    assert again.exit_code == 0, again.output
    assert {path: Path(path).stat().st_mtime_ns for path in before} == before
    assert all(Path(path).stat().st_mtime_ns == kept[path] for path in whole if Path(path).exists())
    assert len(open_store(folder).finished()) == blocks
    undisturbed = CliRunner().invoke(app, [*command, "--jobs", "1", "--out", str(tmp_path / "whole"), "--json"])
    assert undisturbed.exit_code == 0, undisturbed.output
    found = results_of(folder)
    assert found == results_of(tmp_path / "whole")
    flown = {str(path): path.stat().st_mtime_ns for path in folder.rglob("manifest.json")}
    resumed = CliRunner().invoke(app, ["resume", str(folder), "--jobs", "2", "--json"])
    assert resumed.exit_code == 0, resumed.output
    assert results_of(folder) == found
    assert {str(path): path.stat().st_mtime_ns for path in folder.rglob("manifest.json")} == flown


@pytest.mark.parametrize(
    ("name", "other", "differs"),
    [
        ("pair", ["--seeds", "2"], "seeds"),
        ("pair", ["--set", "duration_s=5"], "scenario"),
        ("compare", ["--variant", "near:attacks.jump.params.offset_m=[3,0,0]"], "scenarios, changes"),
        ("matrix", ["--keep", "results"], "keep"),
        ("matrix", ["--seeds", "2"], "matrix"),
    ],
)
def test_a_folder_of_another_plan_or_version_is_refused(
    name: str, other: list[str], differs: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("matrix.toml").write_text(MATRIX)

    def stop(self: InThisProcess, flights: Flights) -> Iterator[Any]:
        raise ShortfallError("interrupted", tmp_path)

    monkeypatch.setattr(InThisProcess, "run", stop)

    def command(*more: str) -> Exception:
        found = CliRunner().invoke(app, [*COMMANDS[name], "--jobs", "1", "--out", "out", *more]).exception
        assert isinstance(found, Exception)
        return found

    first = command()
    assert isinstance(first, ShortfallError)
    assert "0 of" in str(first)
    assert "to go on: skyrange resume out" in str(first)
    refused = command(*other)
    assert isinstance(refused, InputError)
    assert f"{name}: differs in {differs} — expected the {name} that began here" in str(refused)
    wrong = CliRunner().invoke(app, ["study", "resume", "out"]).exception
    assert f"plan.json: kind: '{name}' — expected 'study'" in str(wrong)
    monkeypatch.setattr(store, "version", lambda _: "99")
    for found in (command(), CliRunner().invoke(app, ["resume", "out", "--jobs", "1"]).exception):
        assert isinstance(found, InputError)
        assert "which began it" in str(found)
    Path("out/plan.json").unlink()
    assert "a new or empty folder" in str(command())


@pytest.mark.rotating
def test_a_run_that_fails_does_not_end_a_matrix_and_is_flown_when_it_is_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the undefended run fails too, the cell that waits for it is flown by itself."""
    monkeypatch.chdir(tmp_path)
    Path("matrix.toml").write_text(MATRIX.replace("seeds = 3", "seeds = 1"))
    command = ["matrix", "matrix.toml", "--jobs", "1", "--keep", "everything", "--out", "out", "--json"]
    flown: list[str] = []

    def failing(scenario: Any, folder: Path, **more: Any) -> Any:
        flown.append(folder.relative_to(tmp_path / "out" / "cells").as_posix())
        if flown == ["jump/none/seed-1/nominal"]:
            raise ComponentError("autopilot", "ended")
        return fly(scenario, folder, **more)

    monkeypatch.setattr(flight, "count_together", lambda _: 1)
    monkeypatch.setattr(flight, "fly", failing)
    failed = CliRunner().invoke(app, command).exception
    assert isinstance(failed, ComponentError)
    assert str(failed).startswith("matrix jump/none/seed-1: autopilot: ended")
    assert flown[1:] == ["jump/none/seed-1/attacked", "jump/gate/seed-1/nominal", "jump/gate/seed-1/attacked"]
    again = CliRunner().invoke(app, command)
    assert again.exit_code == 0, again.output
    assert flown[4:] == ["jump/none/seed-1/nominal"], "the attacked run was complete"
    assert load_pair(Path("out/cells/jump/gate/seed-1")).report.is_file()
    assert [len(one["effects"]) for one in json.loads(again.stdout)["cells"]] == [1, 1]
