"""Studies that are flown: equal results whatever the workers, after a kill as without; errors that name the fault."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import time
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.core.errors import ComponentError, InputError, ShortfallError
from skyrange.study import folder as study_folder
from skyrange.study.design.blocks import Block
from skyrange.study.design.model import Study, read_study
from skyrange.study.execution import worker
from skyrange.study.execution.executors import LocalPool
from skyrange.study.execution.study_run import forget_failures, list_failures, run_blocks, run_study
from skyrange.study.execution.worker import DiskFullError
from skyrange.study.folder import StudyFolder, create_folder, open_folder, require_same, require_unchanged
from skyrange.study.measurement import TABLES
from skyrange.study.results import read_results, write_results
from skyrange.study.runs import fly
from skyrange.study.summary import summarise_study

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
    folder = create_folder(study, path)
    result = run_blocks(folder, LocalPool(1), lambda finished, total, _: done.append((finished, total)))
    assert (result.finished, result.flown, result.failed) == (4, 4, [])
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
    assert done == [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]
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
            with open_folder(path).lock():
                break
        except InputError:
            time.sleep(0.05)
    (tmp_path / "study.toml").write_text(TEXT)
    command = ["study", "run", str(tmp_path / "study.toml"), "--jobs", "2", "--out", str(path), "--json"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert {name: (blocks / name).stat().st_mtime_ns for name in before} == before
    assert results_of(path) == results_of(in_turn[0].path)


def test_a_folder_is_of_one_study_one_version_and_one_process(
    study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = create_folder(study, tmp_path / "s")
    with pytest.raises(InputError, match="differs in seeds"):
        require_same(folder, study.model_copy(update={"seeds": 3}))
    with pytest.raises(InputError, match="the study other"):
        require_same(folder, study.model_copy(update={"name": "other"}))
    with folder.lock(), pytest.raises(InputError, match="no other process"), open_folder(folder.path).lock():
        pass
    monkeypatch.setattr(study_folder, "version", lambda _: "99")
    with pytest.raises(InputError, match="which began it"):
        require_unchanged(folder)
    with pytest.raises(InputError, match="which began it"):
        run_study(study, folder.path)
    refused = CliRunner().invoke(app, ["study", "resume", str(folder.path)])
    assert isinstance(refused.exception, InputError)
    assert "which began it" in str(refused.exception)
    require_unchanged(folder, other_version=True)


@pytest.mark.parametrize("problem", [ComponentError("autopilot", "ended"), ValueError("autopilot: ended")])
def test_a_run_that_fails_is_kept_with_its_error_and_flown_again_when_asked_for(
    small: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, problem: Exception
) -> None:

    def failing(scenario: Any, out: Path, **more: Any) -> Any:
        if out.name == "attacked" and out.parent.name == "p0001-s1":
            raise problem
        return fly(scenario, out, **more)

    monkeypatch.setattr(worker, "fly", failing)
    folder = create_folder(small, tmp_path / "s")
    result = run_blocks(folder, LocalPool(2))
    assert [name for name, _ in result.failed] == ["p0001-s1"]
    assert "autopilot: ended" in result.failed[0][1]
    failed = [row for row in read_results(folder.path, "runs").to_pylist() if row["status"] == "failed"]
    assert [(row["block"], row["arm"]) for row in failed] == [("p0001-s1", "attacked")]
    assert sum(cell.failed for cell in summarise_study(folder)) == 1
    monkeypatch.setattr(worker, "fly", fly)
    forget_failures(folder)
    assert run_blocks(folder, LocalPool(1)).flown == 1
    assert list_failures(folder) == []


def test_a_run_that_a_signal_ends_is_flown_when_the_study_goes_on(
    small: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    def told_to_end(scenario: Any, out: Path, **more: Any) -> Any:
        raise ShortfallError("interrupted at 3.0 of 22.0 simulated seconds", out)

    folder = create_folder(small, tmp_path / "s")
    monkeypatch.setattr(worker, "fly", told_to_end)
    with pytest.raises(ShortfallError, match="interrupted at 3"):
        run_blocks(folder, LocalPool(2))
    assert folder.finished() == []
    monkeypatch.setattr(worker, "fly", fly)
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
    run_one = LocalPool(1).run(folder.blocks[:1], lambda block: worker.fly_block(study, block, folder.path), 60.0, bool)
    assert len(list(run_one)) == 1
    monkeypatch.setattr(worker, "fly", full)
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
