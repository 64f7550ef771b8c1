"""Run of a plan: what is not finished is flown by an executor and stored, with progress."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from time import monotonic
from typing import Final, NamedTuple

from skyrange.core.errors import ComponentError, InputError, ShortfallError
from skyrange.runtime.compilation import fill_cache, is_cold
from skyrange.runtime.interrupt import Interruptible
from skyrange.runtime.warm_up import warm_up
from skyrange.study.execution.executors import (
    BlockQueue,
    Executor,
    Flights,
    FlyGroup,
    GroupEvents,
    InThisProcess,
    LocalPool,
    Outcome,
    UnderWay,
    WorkerFailure,
)
from skyrange.study.execution.plan import PlannedBlock, RunPlan
from skyrange.study.execution.storage import BlockStorage
from skyrange.study.execution.store import BlockResult, RunStore
from skyrange.study.execution.worker import fly_group, fly_to_storage, note_failure

_MB: Final = 1e6
_TURNS: Final = 3
"""Groups of blocks that each worker gets at least, if there are enough, so that all end at about the same time."""
_FEW: Final = 4
"""Blocks of a worker; with fewer it loads compiled functions itself, which takes less than a warm-up of all."""


class PlanProgress(NamedTuple):
    """How far a plan is."""

    finished: int
    """Runs that are finished, with those of earlier sessions and those that needed no flight."""
    runs: int
    """All runs of the plan."""
    under_way: float
    """Runs that are flown of blocks that are not finished, with the shares of those in the air."""
    left_s: float | None
    """Wall time that is left, in s; `None` as long as nothing says it."""
    groups: Sequence[tuple[str, int, float]] = ()
    """See `UnderWay.groups`."""
    remarks: Sequence[str] = ()
    """What a user should know of what was flown, beside errors; it only grows."""
    events: Sequence[GroupEvents] = ()
    """What happened in runs that fly alone since the progress before."""


OnPlanProgress = Callable[[PlanProgress], None]


@dataclass(frozen=True)
class PlanResult:
    """What one session has flown."""

    finished: int
    """Blocks that are finished, with those of earlier sessions."""
    flown: int
    """Blocks that this session flew."""
    failures: Sequence[BlockResult]
    """Blocks with failed runs, of all sessions."""
    wall_s: float
    """Of this session."""
    busy_share: float
    """The share of the workers' time in which they flew blocks."""


def choose_executor(jobs: int) -> Executor:
    """What flies so many runs at a time: this process one, a pool of processes more."""
    return InThisProcess() if jobs == 1 else LocalPool(jobs)


def run_plan(
    plan: RunPlan,
    store: RunStore,
    executor: Executor,
    on_progress: OnPlanProgress | None = None,
    storage: BlockStorage | None = None,
) -> PlanResult:
    """Fly the blocks of a plan that are not finished.

    With `storage` blocks are flown in temporary folders of their machines, and come here through it; those that are in
    it already are fetched.

    Raises `ShortfallError` after Ctrl-C, or when the budget of disk is used up, with how to go on; `DiskFullError` when
    nothing more can be written.
    """
    with store.lock(), Interruptible() as interrupt:
        if storage is not None:
            _fetch_blocks(plan, store, storage)
        return _Session(plan, store, executor, on_progress, storage).run(interrupt)


def forget_failures(store: RunStore, storage: BlockStorage | None = None) -> None:
    """Count the blocks with failed runs as not finished, here and in the storage, so that they are flown again."""
    with store.lock():
        for result in store.list_failures():
            if storage is not None:
                storage.remove(result.name)
            store.forget(result.name)


def require_success(plan: RunPlan, result: PlanResult) -> None:
    """Raise `ComponentError` if a run failed."""
    if result.failures:
        first, more = result.failures[0], len(result.failures) - 1
        others = f"; and {more} more" if more else ""
        hint = "The same command, or skyrange resume, flies what failed again; the rest is kept."
        raise ComponentError(f"{plan.kind} {first.name}", f"{first.errors[0]}{others}", hint)


class _Session:
    """One call of `run_plan`."""

    def __init__(
        self,
        plan: RunPlan,
        store: RunStore,
        executor: Executor,
        on_progress: OnPlanProgress | None,
        storage: BlockStorage | None,
    ) -> None:
        self._plan, self._store, self._executor = plan, store, executor
        self._on_progress, self._storage = on_progress, storage
        self._blocks = {block.name: block for block in plan.blocks}
        self._done = store.finished() & self._blocks.keys()
        self._waiters = self._count_waiters()
        self._runs = sum(len(block.folders) for block in plan.blocks)
        self._finished_runs = sum(len(self._blocks[name].folders) for name in self._done)
        self._left_work = sum(block.work for block in plan.blocks if block.name not in self._done)
        self._flown_work = self._busy_s = 0.0
        self._flown = self._used_bytes = 0
        self._failures = store.list_failures()
        self._under_way = UnderWay(0.0, 0.0)
        self._began = monotonic()
        self._reason = ""
        self._remarks: dict[str, None] = {}
        self._events: list[GroupEvents] = []

    def run(self, interrupt: Interruptible) -> PlanResult:
        plan, store = self._plan, self._store
        due = [block for block in plan.blocks if block.name not in self._done]
        if plan.max_disk_mb is not None:
            self._used_bytes = sum(store.read(name)[0].disk_bytes for name in self._done)
        self._release_all()
        self._load_compiled(due)
        self._began = monotonic()
        queue = BlockQueue(plan.blocks, self._done, in_order=plan.in_order, group=self._choose_group(due))
        root = store.path.absolute()  # a worker of a cluster has another working directory
        fly: FlyGroup = partial(fly_group, plan, root)
        if self._storage is not None:
            fly = partial(fly_to_storage, plan, self._storage.url)
        on_events = None if self._on_progress is None else self._events.append
        stop = partial(self._stop, interrupt)
        flights = Flights(queue, fly, plan.run_limit_s, stop, self._note_under_way, self._note, on_events)
        self._tell()
        try:
            for block in [waiting for waiting in due if waiting.waits_for in self._done]:
                self._settle(queue, block)
            for block, outcome in self._executor.run(flights):
                self._take(queue, block, outcome)
        except ShortfallError as error:
            self._reason = self._reason or str(error)
        wall_s = monotonic() - self._began
        total = len(self._blocks)
        if self._reason and len(self._done) < total:
            summary = f"{len(self._done)} of {total} blocks are finished; to go on: {plan.resume} {store.path}"
            raise ShortfallError(f"{self._reason}; {summary}", store.path)
        share = self._busy_s / (wall_s * self._executor.jobs) if self._flown else 1.0
        return PlanResult(len(self._done), self._flown, self._failures, wall_s, share)

    def _choose_group(self, due: Sequence[PlannedBlock]) -> int:
        """How many blocks a worker gets at once: as many as may fly together, but several times for each worker."""
        if not due or self._storage is not None:
            return 1
        runs = sum(len(block.folders) for block in due) / len(due)
        share = len(due) / (_TURNS * self._executor.jobs)
        return max(int(min(self._plan.together / max(runs, 1.0), share)), 1)

    def _stop(self, interrupt: Interruptible) -> bool:
        limit_mb = self._plan.max_disk_mb
        if interrupt.requested:
            self._reason = "interrupted"
        elif limit_mb is not None and self._used_bytes > limit_mb * _MB:
            self._reason = f"the runs take more than max_disk_mb, {limit_mb:g}"
        return bool(self._reason)

    def _load_compiled(self, due: Sequence[PlannedBlock]) -> None:
        """Compile what this version has not, so that no two workers do, and load it once before they are forked."""
        if not due or isinstance(self._executor, InThisProcess):
            return
        if is_cold():
            fill_cache(self._executor.jobs)
        if len(due) >= _FEW * self._executor.jobs or self._plan.in_order:
            first = next(block for block in due if block.waits_for in ("", *self._done))
            scenario = self._plan.plan_runs(first, self._store)[-1].scenario
            if not isinstance(scenario, InputError):
                warm_up(scenario)

    def _take(self, queue: BlockQueue, block: PlannedBlock, outcome: Outcome) -> None:
        """Take what became of a block that was flown."""
        if isinstance(outcome, WorkerFailure):
            result = note_failure(self._plan, self._store, block, str(outcome))
        else:
            if self._storage is not None:
                self._storage.fetch(block.name, self._store.path)
            result = outcome
        self._flown += 1
        self._flown_work += block.work
        self._busy_s += result.wall_s
        self._used_bytes += result.disk_bytes
        self._failures += [result] if result.failed else []
        for remark in result.remarks:
            self._note(remark)
        self._finish(queue, block)

    def _settle(self, queue: BlockQueue, block: PlannedBlock) -> None:
        """Store a block without a flight if that which it waited for tells what it would say, or let it be flown."""
        data = self._plan.settle(block, self._store)
        if data is None:
            queue.add(block)
            return
        self._store.write(BlockResult(block.name, 0, 0, (), 0.0, 0.0, 0), data)
        self._finish(queue, block)

    def _finish(self, queue: BlockQueue, block: PlannedBlock) -> None:
        self._done.add(block.name)
        self._left_work -= block.work
        self._finished_runs += len(block.folders)
        for name in self._list_awaited(block):
            self._waiters[name] -= 1
            self._release(name)
        self._release(block.name)
        for waiting in queue.finish(block):
            self._settle(queue, waiting)
        self._tell()

    def _list_awaited(self, block: PlannedBlock) -> list[str]:
        """The blocks that a block waits for, directly or through others."""
        awaited = []
        while block.waits_for:
            block = self._blocks[block.waits_for]
            awaited.append(block.name)
        return awaited

    def _count_waiters(self) -> dict[str, int]:
        """How many unfinished blocks wait for each block that others wait for, directly or through others."""
        waiters: dict[str, int] = {}
        for block in self._blocks.values():
            for name in self._list_awaited(block):
                waiters[name] = waiters.get(name, 0) + (block.name not in self._done)
        return waiters

    def _release(self, name: str) -> None:
        if self._waiters.get(name) == 0 and name in self._done:
            self._plan.release(self._blocks[name], self._store.path)

    def _release_all(self) -> None:
        for name in self._waiters:
            self._release(name)

    def _note_under_way(self, under_way: UnderWay) -> None:
        grown, self._under_way = under_way.runs > self._under_way.runs, under_way
        if grown:  # where it shrinks a block has ended, which is told next
            self._tell()

    def _note(self, remark: str) -> None:
        self._remarks[remark] = None

    def _tell(self) -> None:
        if self._on_progress is None:
            return
        flown = self._flown_work + self._under_way.work
        left = max(self._left_work - self._under_way.work, 0.0)
        left_s = (monotonic() - self._began) / flown * left if flown > 0.0 else None
        runs, _, groups = self._under_way
        remarks, events = list(self._remarks), list(self._events)
        self._events.clear()  # who adds to it holds it
        self._on_progress(PlanProgress(self._finished_runs, self._runs, runs, left_s, groups, remarks, events))


def _fetch_blocks(plan: RunPlan, store: RunStore, storage: BlockStorage) -> None:
    """Fetch the blocks that are in the storage and not here: those that ended after this side did."""
    storage.claim(store.digest)
    stored = storage.list_blocks() - store.finished()
    for block in plan.blocks:
        if block.name in stored:
            storage.fetch(block.name, store.path)
