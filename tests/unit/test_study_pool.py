"""Pool of a study's workers: what is flown, in what order it ends, and what happens to one that dies or hangs."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from skyrange.core.errors import ComponentError
from skyrange.study.design.blocks import Block
from skyrange.study.execution.executors import LocalPool, Outcome, WorkerFailure
from skyrange.study.folder import BlockResult

BLOCKS = [Block(f"b{number}", number, 1, {}) for number in range(6)]


def _result(block: Block) -> BlockResult:
    return BlockResult(block.name, 1, 0, (), 0.0, 0.0, os.getpid())


def _killed_at_two(block: Block) -> BlockResult:
    if block.point == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return _result(block)


def _hanging_at_two(block: Block) -> BlockResult:
    if block.point == 2:
        time.sleep(60)
    return _result(block)


def _failing_at_two(block: Block) -> BlockResult:
    if block.point == 2:
        raise ZeroDivisionError("two")
    return _result(block)


def _run(jobs: int, fly: object, limit_s: float = 30.0) -> dict[str, Outcome]:
    found = LocalPool(jobs).run(BLOCKS, fly, limit_s, lambda: False)  # type: ignore[arg-type]
    return {block.name: outcome for block, outcome in found}


@pytest.mark.parametrize("jobs", [1, 2, 3, 9])
def test_every_block_is_flown_once_by_processes_that_stay(jobs: int) -> None:
    found = _run(jobs, _result)
    assert sorted(found) == [block.name for block in BLOCKS]
    workers = {outcome.disk_bytes for outcome in found.values() if isinstance(outcome, BlockResult)}
    assert 1 <= len(workers) <= min(jobs, len(BLOCKS))
    assert os.getpid() not in workers


@pytest.mark.parametrize(
    ("fly", "limit_s", "says"),
    [(_killed_at_two, 30.0, "its process was ended by SIGKILL"), (_hanging_at_two, 4.0, "took longer than 4 s")],
)
def test_a_worker_that_dies_or_hangs_loses_its_own_block_alone(fly: object, limit_s: float, says: str) -> None:
    found = _run(2, fly, limit_s)
    assert sorted(found) == [block.name for block in BLOCKS]
    lost = [name for name, outcome in found.items() if isinstance(outcome, WorkerFailure)]
    assert lost == ["b2"]
    assert says in str(found["b2"])


def test_an_error_in_the_code_is_raised_with_the_block() -> None:
    with pytest.raises(ComponentError, match=r"block b2: ZeroDivisionError\('two'\)"):
        _run(2, _failing_at_two)


def test_nothing_is_begun_after_stop_and_no_process_stays(tmp_path: Path) -> None:
    pids: list[int] = []
    for _, outcome in LocalPool(2).run(BLOCKS, _result, 30.0, lambda: len(pids) >= 2):
        assert isinstance(outcome, BlockResult)
        pids.append(outcome.disk_bytes)
    assert 2 <= len(pids) < len(BLOCKS)
    for pid in set(pids):
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
