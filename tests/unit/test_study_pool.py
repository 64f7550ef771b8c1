"""Pool of workers: what is flown, in what order it ends, and what happens to a worker that dies or hangs."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from skyrange.core.errors import ComponentError
from skyrange.study.execution.executors import BlockQueue, Flights, InThisProcess, LocalPool, Outcome, WorkerFailure
from skyrange.study.execution.plan import PlannedBlock
from skyrange.study.execution.store import BlockResult

BLOCKS = [PlannedBlock(f"b{number}", (f"b{number}/run",)) for number in range(6)]


def _result(block: PlannedBlock) -> BlockResult:
    return BlockResult(block.name, 1, 0, (), 0.0, 0.0, os.getpid())


def _fly(group: Sequence[PlannedBlock], on_flown: object = None, **_: object) -> list[BlockResult]:
    return [_result(block) for block in group]


def _killed_at_two(group: Sequence[PlannedBlock], on_flown: object = None, **_: object) -> list[BlockResult]:
    if any(block.name == "b2" for block in group):
        os.kill(os.getpid(), signal.SIGKILL)
    return _fly(group)


def _hanging_at_two(group: Sequence[PlannedBlock], on_flown: object = None, **_: object) -> list[BlockResult]:
    if any(block.name == "b2" for block in group):
        time.sleep(60)
    return _fly(group)


def _failing_at_two(group: Sequence[PlannedBlock], on_flown: object = None, **_: object) -> list[BlockResult]:
    if any(block.name == "b2" for block in group):
        raise ZeroDivisionError("two")
    return _fly(group)


def _tell(queue: BlockQueue, fly: object = _fly, limit_s: float = 30.0, **more: object) -> Flights:
    """What an executor is told; it reports to nobody."""
    silent = {"stop": lambda: False, "on_under_way": lambda _: None, "on_remark": lambda _: None}
    return Flights(queue, fly, limit_s, **{**silent, **more})  # type: ignore[arg-type]


def _run(
    jobs: int, fly: object, limit_s: float = 30.0, group: int = 1, remarks: list[str] | None = None
) -> dict[str, Outcome]:
    queue = BlockQueue(BLOCKS, group=group)
    flights = _tell(queue, fly, limit_s, on_remark=([] if remarks is None else remarks).append)
    found = {}
    for block, outcome in LocalPool(jobs).run(flights):
        queue.finish(block)
        assert block.name not in found
        found[block.name] = outcome
    return found


@pytest.mark.parametrize(("jobs", "group"), [(1, 1), (2, 1), (3, 2), (9, 4)])
def test_every_block_is_flown_once_by_processes_that_stay(jobs: int, group: int) -> None:
    found = _run(jobs, _fly, group=group)
    assert sorted(found) == [block.name for block in BLOCKS]
    workers = {outcome.disk_bytes for outcome in found.values() if isinstance(outcome, BlockResult)}
    assert 1 <= len(workers) <= min(jobs, len(BLOCKS))
    assert os.getpid() not in workers


@pytest.mark.parametrize("group", [1, 3])
@pytest.mark.parametrize(
    ("fly", "limit_s", "says"),
    [(_killed_at_two, 30.0, "its process was ended by SIGKILL"), (_hanging_at_two, 1.0, "took longer than 1 s")],
)
def test_a_worker_that_dies_or_hangs_loses_its_own_block_alone(
    fly: object, limit_s: float, says: str, group: int
) -> None:
    remarks: list[str] = []
    found = _run(2, fly, limit_s, group, remarks)
    assert sorted(found) == [block.name for block in BLOCKS]
    assert (len(remarks), all("each of them is flown again" in remark for remark in remarks)) == (group // 3, True)
    lost = [name for name, outcome in found.items() if isinstance(outcome, WorkerFailure)]
    assert lost == ["b2"]
    assert says in str(found["b2"])


def test_an_error_in_the_code_is_raised_with_the_block() -> None:
    with pytest.raises(ComponentError, match=r"block b2: ZeroDivisionError\('two'\)"):
        _run(2, _failing_at_two)


def test_nothing_is_begun_after_stop_and_no_process_stays(tmp_path: Path) -> None:
    pids: list[int] = []
    queue = BlockQueue(BLOCKS)
    for _, outcome in LocalPool(2).run(_tell(queue, stop=lambda: len(pids) >= 2)):
        assert isinstance(outcome, BlockResult)
        pids.append(outcome.disk_bytes)
    assert 2 <= len(pids) < len(BLOCKS)
    for pid in set(pids):
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def _names(queue: BlockQueue) -> Iterator[str]:
    for block, _ in InThisProcess().run(_tell(queue)):
        yield block.name
        for waiting in queue.finish(block):
            queue.add(waiting)


def test_what_others_wait_for_comes_first_and_then_most_work() -> None:
    blocks = [
        PlannedBlock("short", ("a",), 1.0),
        PlannedBlock("long", ("b",), 9.0),
        PlannedBlock("awaited", ("c",), 2.0),
        PlannedBlock("waits", ("d",), 5.0, "awaited"),
        PlannedBlock("waits too", ("e",), 7.0, "waits"),
    ]
    assert list(_names(BlockQueue(blocks))) == ["awaited", "waits", "long", "waits too", "short"]
    assert list(_names(BlockQueue(blocks[:3], in_order=True))) == ["short", "long", "awaited"]
    assert list(_names(BlockQueue(blocks, {"awaited", "long"}))) == ["short"], "the driver adds what waited before"


def test_a_group_is_of_one_round_and_of_the_same_scenarios() -> None:
    blocks = [
        PlannedBlock(f"{name}{seed}", (f"{name}{seed}",), work, round=seed // 2, alike=name)
        for name, work in (("a", 1.0), ("b", 2.0))
        for seed in range(3)
    ]
    queue, groups = BlockQueue(blocks, group=2), []
    while group := queue.take():
        groups.append([block.name for block in group])
    assert groups == [["b0", "b1"], ["a0", "a1"], ["b2"], ["a2"]]
    by_seed = [PlannedBlock(f"{name}{seed}", ("r",), alike=name) for seed in range(2) for name in "ab"]
    queue = BlockQueue(by_seed, group=2)
    assert [[block.name for block in queue.take()] for _ in range(2)] == [["a0", "a1"], ["b0", "b1"]]
    assert BlockQueue(by_seed).take() == by_seed[:1]
