"""Studies that are flown: equal results whatever the workers, after a kill as without; errors that name the fault."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.core.errors import ComponentError, InputError, ShortfallError
from skyrange.scenario.model.scenario import Scenario
from skyrange.study import study_run
from skyrange.study.design.blocks import Block, scenario_in
from skyrange.study.design.model import Study, StudyArm, read_study
from skyrange.study.execution import flight, plan_run, store, worker
from skyrange.study.execution.executors import InThisProcess, LocalPool
from skyrange.study.execution.flight import DiskFullError, fly_runs
from skyrange.study.execution.plan import PlannedRun
from skyrange.study.execution.plan_run import PlanProgress, forget_failures
from skyrange.study.execution.worker import fly_group
from skyrange.study.folder import StudyFolder, open_folder, require_same, require_unchanged
from skyrange.study.measurement import TABLES
from skyrange.study.results import read_results, write_results
from skyrange.study.runs import fly
from skyrange.study.study_run import StudyPlan, create_folder, list_failures, run_blocks, run_study
from skyrange.study.summary import summarise_study

pytestmark = pytest.mark.rotating

TEXT = """
name = "jumps"
scenario = "gnss.jump"
changes = ["duration_s=4"]
seeds = 2
arms = ["nominal", "attacked", { id = "defended", defences = [{ kind = "gnss.innovation" }] }]

[[factors]]
name = "size"
key = "attacks.jump.params.offset_m"
values = [[10, 0, 0], [30, 0, 0]]

[[draws]]
name = "onset"
key = "attacks.jump.start_s"
low = 2.4
high = 3.4

[[detectors]]
id = "gap"
kind = "heartbeat.gap"
"""


@pytest.fixture
def study(tmp_path: Path) -> Study:
    path = tmp_path / "study.toml"
    path.write_text(TEXT)
    return read_study(path)


@pytest.fixture
def small(study: Study) -> Study:
    """The same with two blocks of two arms."""
    return study.model_copy(update={"seeds": 1, "arms": study.arms[:2]})


def fly_in_turn(study: Study, path: Path) -> tuple[StudyFolder, list[tuple[int, int]]]:
    """The folder of a study that one worker flew, and the progress that was told."""
    done: list[tuple[int, int]] = []

    def tell(told: PlanProgress) -> None:
        assert told.finished + told.under_way <= told.runs
        done.append((told.finished, told.runs))

    folder = create_folder(study, path)
    found = run_blocks(folder, LocalPool(1), tell)
    assert (found.finished, found.flown, found.failed) == (4, 4, [])
    return folder, done


@pytest.fixture(scope="module")
def in_turn(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyFolder, list[tuple[int, int]]]:
    path = tmp_path_factory.mktemp("one")
    (path / "study.toml").write_text(TEXT)
    return fly_in_turn(read_study(path / "study.toml"), path / "out")


def results_of(path: Path) -> dict[str, list[dict[str, Any]]]:
    return {table: read_results(path, table).to_pylist() for table in TABLES}


def test_results_do_not_depend_on_the_workers(
    study: Study, in_turn: tuple[StudyFolder, list[tuple[int, int]]], tmp_path: Path
) -> None:
    one, done = in_turn
    assert list(dict.fromkeys(done)) == [(0, 12), (3, 12), (6, 12), (9, 12), (12, 12)]
    several = create_folder(study, tmp_path / "several")
    several.blocks.reverse()
    run_blocks(several, LocalPool(2))
    several.blocks.reverse()
    expected = results_of(one.path)
    write_results(several)
    assert results_of(several.path) == expected
    runs = expected["runs"]
    assert len(runs) == 12
    assert {row["status"] for row in runs} == {"complete"}
    assert len({row["fingerprint"] for row in runs if row["arm"] == "nominal"}) == 2  # the size has no effect there
    assert all(row["onset"] == other["onset"] for row in runs for other in runs if row["block"] == other["block"])
    effects = expected["effects"]
    assert {row["arm"] for row in effects} == {"attacked", "defended"}
    assert all(row["against"] == "nominal" for row in effects)
    assert {row["attack"] for row in expected["acts"]} == {"jump"}
    assert {row["kind"] for row in expected["acts"]} == {"gnss.jump"}
    assert not (one.path / "runs").exists() or not any((one.path / "runs").iterdir())
    cells = summarise_study(one)
    assert [(cell.arm, cell.runs) for cell in cells] == [
        (arm, 2) for _ in range(2) for arm in ("nominal", "attacked", "defended")
    ]


def test_a_killed_study_goes_on_without_flying_finished_runs_again(
    study: Study, in_turn: tuple[StudyFolder, list[tuple[int, int]]], tmp_path: Path
) -> None:
    path = tmp_path / "killed"
    folder = create_folder(study, path)

    process = multiprocessing.get_context("fork").Process(target=run_blocks, args=(folder, LocalPool(2)))
    process.start()
    blocks = path / "blocks"
    deadline = time.monotonic() + 120.0
    while time.monotonic() < deadline and not any(blocks.glob("*.json")):
        time.sleep(0.05)
    assert process.pid is not None
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    before = {file.name: file.stat().st_mtime_ns for file in blocks.glob("*.json")}
    assert before
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline:  # its workers end with it
        try:
            with open_folder(path).store.lock():
                break
        except InputError:
            time.sleep(0.05)
    (tmp_path / "study.toml").write_text(TEXT)
    command = ["study", "run", str(tmp_path / "study.toml"), "--jobs", "2", "--out", str(path), "--json"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert {name: (blocks / name).stat().st_mtime_ns for name in before} == before
    assert results_of(path) == results_of(in_turn[0].path)


def test_the_runs_of_a_group_of_blocks_are_flown_by_one_call(
    small: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, calls = create_folder(small, tmp_path / "s"), []

    def counted(runs: Sequence[PlannedRun], *more: Any, **named: Any) -> Any:
        calls.append([run.folder for run in runs])
        return fly_runs(runs, *more, **named)

    monkeypatch.setattr(plan_run, "_TURNS", 0.1)
    monkeypatch.setattr(worker, "fly_runs", counted)
    assert run_blocks(folder, InThisProcess()).flown == 2
    assert calls == [[f"runs/{block.name}/{arm}" for block in folder.blocks for arm in ("nominal", "attacked")]]
    assert len(read_results(folder.path, "runs")) == 4


def test_a_folder_is_of_one_study_one_version_and_one_process(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = create_folder(study, tmp_path / "s")
    with pytest.raises(InputError, match="differs in seeds"):
        require_same(folder, study.model_copy(update={"seeds": 3}))
    with pytest.raises(InputError, match="the study other"):
        require_same(folder, study.model_copy(update={"name": "other"}))
    with (
        folder.store.lock(),
        pytest.raises(InputError, match="no other process"),
        open_folder(folder.path).store.lock(),
    ):
        pass
    monkeypatch.setattr(store, "version", lambda _: "99")
    with pytest.raises(InputError, match="which began it"):
        require_unchanged(folder)
    with pytest.raises(InputError, match="which began it"):
        run_study(study, folder.path)
    refused = CliRunner().invoke(app, ["study", "resume", str(folder.path)])
    assert isinstance(refused.exception, InputError)
    assert "which began it" in str(refused.exception)
    folder.store.allow_version()
    require_unchanged(open_folder(folder.path))


@pytest.mark.parametrize("problem", [ComponentError("autopilot", "ended"), ValueError("autopilot: ended")])
def test_a_run_that_fails_is_kept_with_its_error_and_flown_again_when_asked_for(
    small: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, problem: Exception
) -> None:

    def failing(scenario: Any, out: Path, **more: Any) -> Any:
        if out.name == "attacked" and out.parent.name == "p0001-s1":
            raise problem
        return fly(scenario, out, **more)

    monkeypatch.setattr(flight, "count_together", lambda _: 1)
    monkeypatch.setattr(flight, "fly", failing)
    folder = create_folder(small, tmp_path / "s")
    result = run_blocks(folder, LocalPool(2))
    assert [name for name, _ in result.failed] == ["p0001-s1"]
    assert "autopilot: ended" in result.failed[0][1]
    failed = [row for row in read_results(folder.path, "runs").to_pylist() if row["status"] == "failed"]
    assert [(row["block"], row["arm"]) for row in failed] == [("p0001-s1", "attacked")]
    assert sum(cell.failed for cell in summarise_study(folder)) == 1
    monkeypatch.setattr(flight, "fly", fly)
    forget_failures(folder.store)
    assert run_blocks(folder, LocalPool(1)).flown == 1
    assert list_failures(folder) == []


def test_a_scenario_that_is_wrong_fails_its_own_run_alone(
    small: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(study: Study, arm: StudyArm, block: Block) -> Scenario:
        if (arm.id, block.name) == ("attacked", "p0001-s1"):
            raise InputError.one("scenario jumps", "onset", "9", "less")
        return scenario_in(study, arm, block)

    folder = create_folder(small, tmp_path / "s")
    monkeypatch.setattr(study_run, "scenario_in", wrong)
    assert run_blocks(folder, LocalPool(2)).failed == [("p0001-s1", "scenario jumps: onset: 9 — expected less")]
    status = {(row["block"], row["arm"]): row["status"] for row in read_results(folder.path, "runs").to_pylist()}
    assert [one for one, how in status.items() if how != "complete"] == [("p0001-s1", "attacked")]


def test_a_run_that_a_signal_ends_is_flown_when_the_study_goes_on(
    small: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    def told_to_end(scenario: Any, out: Path, **more: Any) -> Any:
        raise ShortfallError("interrupted at 3.0 of 22.0 simulated seconds", out)

    folder = create_folder(small, tmp_path / "s")
    monkeypatch.setattr(flight, "count_together", lambda _: 1)
    monkeypatch.setattr(flight, "fly", told_to_end)
    with pytest.raises(ShortfallError, match="interrupted at 3"):
        run_blocks(folder, LocalPool(2))
    assert folder.finished() == []
    monkeypatch.setattr(flight, "fly", fly)
    assert run_blocks(folder, LocalPool(2)).failed == []


@pytest.mark.slow
def test_a_full_disk_ends_the_study_and_a_budget_does(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = study.model_copy(update={"keep": "everything", "max_disk_mb": 0.001})
    budget = create_folder(kept, tmp_path / "budget")
    with pytest.raises(ShortfallError, match=r"max_disk_mb, 0\.001; 1 of 4"):
        run_blocks(budget, LocalPool(1))
    assert len(read_results(budget.path, "runs")) == 3

    def full(*_: Any, **__: Any) -> Any:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    folder = create_folder(study, tmp_path / "full")
    plan = StudyPlan(study, folder.blocks)
    assert len(fly_group(plan, folder.path, plan.blocks[:1])) == 1
    monkeypatch.setattr(flight, "count_together", lambda _: 1)
    monkeypatch.setattr(flight, "fly", full)
    with pytest.raises(DiskFullError, match="the disk is full"):
        run_blocks(folder, LocalPool(2))
    assert len(folder.finished()) == 1
    assert len(read_results(folder.path, "runs")) == 3


def test_tables_that_are_kept(study: Study, tmp_path: Path) -> None:
    some = study.model_copy(
        update={"keep": ("truth", "frames"), "changes": ("duration_s=12",), "seeds": 1, "factors": ()}
    )
    folder = create_folder(some, tmp_path / "s")
    run_blocks(folder, LocalPool(2))
    block: Block = folder.blocks[0]
    for table in ("truth", "frames"):
        parts = sorted((folder.path / "kept" / table / block.name / "attacked").glob("*.parquet"))
        assert sum(pa.parquet.read_metadata(part).num_rows for part in parts) > 100
    assert not (folder.path / "runs" / block.name).exists()
