"""Executors of blocks: this process, a pool of processes of this machine, or tasks of a Ray cluster; and their queue.

Processes are forked where the system can, after the compiled functions were loaded, so that these are in memory once
and plugins are known. Each is pinned to a CPU, and has a process group of its own: Ctrl-C reaches the parent alone,
which forwards it once, so that every run ends with a complete record. On Linux they end with the process that started
them.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from heapq import heappop, heappush
from importlib import import_module
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Final, NamedTuple, Protocol

from skyrange.core.errors import ComponentError, InputError, ShortfallError, SkyrangeError
from skyrange.core.extras import describe_install
from skyrange.io.processes.program import end_with_parent
from skyrange.runtime.cores.division import available_cpus
from skyrange.runtime.event_reports import EventReport
from skyrange.runtime.interrupt import Interruptible
from skyrange.runtime.memory import collect_less
from skyrange.study.execution.flight import OnEvents, OnFlown, Stop
from skyrange.study.execution.plan import PlannedBlock
from skyrange.study.execution.store import BlockResult

Group = Sequence[PlannedBlock]


class FlyGroup(Protocol):
    """Flies a group of blocks and stores each; returns their results in order. It can be pickled."""

    def __call__(
        self,
        group: Group,
        on_flown: OnFlown | None = None,
        *,
        stop: Stop | None = None,
        on_events: OnEvents | None = None,
    ) -> list[BlockResult]:
        """See `worker.fly_group`."""
        ...


class WorkerFailure(str):
    """Why a block has no result: its worker was killed, or took too long."""

    __slots__ = ()


Outcome = BlockResult | WorkerFailure


class BlockQueue:
    """Blocks in the order in which they are flown.

    Round by round, first those that others wait for, then those with the most work, so that the last ones are short;
    with `in_order`, in the given order. A block that waits for another is not in the queue until it is added.
    """

    def __init__(
        self, blocks: Group, finished: Collection[str] = (), *, in_order: bool = False, group: int = 1
    ) -> None:
        self._number = {block.name: number for number, block in enumerate(blocks)}
        self._in_order = in_order
        self._group = group
        self._kind: dict[str, int] = {}
        """Numbers of `PlannedBlock.alike`: where groups have several blocks, those of a group follow each other."""
        self._ready: list[tuple[int, bool, float, int, int, PlannedBlock]] = []
        self._held: dict[str, list[PlannedBlock]] = {}
        """Blocks by the name of the block that they wait for."""
        self._alone: set[str] = set()
        """Blocks that a worker gets one at a time, because a worker that had several died."""
        self.left = 0
        """Blocks that are not finished."""
        self._awaited = {block.waits_for for block in blocks} - {""}
        for block in blocks:
            if block.name in finished:
                continue
            self.left += 1
            if not block.waits_for:
                self.add(block)
            elif block.waits_for not in finished:
                self._held.setdefault(block.waits_for, []).append(block)

    def add(self, block: PlannedBlock) -> None:
        """Let a block be flown."""
        number = self._number[block.name]
        kind = self._kind.setdefault(block.alike, len(self._kind)) if self._group > 1 else 0
        key = (block.round, block.name not in self._awaited, -block.work, kind)
        heappush(self._ready, (*((0, False, 0.0, 0) if self._in_order else key), number, block))

    def take(self) -> list[PlannedBlock]:
        """The next group of blocks to be flown; empty if none is ready."""
        group: list[PlannedBlock] = []
        while self._ready and len(group) < self._group:
            block = self._ready[0][-1]
            if group and (block.alike != group[0].alike or self._alone & {block.name, group[0].name}):
                break
            heappop(self._ready)
            group.append(block)
        return group

    def fly_alone(self, group: Group) -> None:
        """Put back blocks that a worker had together when it died."""
        self._alone.update(block.name for block in group)
        for block in group:
            self.add(block)

    def finish(self, block: PlannedBlock) -> list[PlannedBlock]:
        """Note that a block is finished; returns those that waited for it, which are not in the queue yet."""
        self.left -= 1
        return self._held.pop(block.name, [])


class GroupEvents(NamedTuple):
    """What happened in a run that flies alone."""

    group: str
    """The first block of its group, as in `UnderWay.groups`."""
    folder: str
    """Of the run."""
    report: EventReport


class UnderWay(NamedTuple):
    """What is being flown."""

    runs: float
    """Runs that workers have flown of the blocks that they have not finished, with the shares of those in the air."""
    work: float
    """The same as work."""
    groups: Sequence[tuple[str, int, float]] = ()
    """Of each group the name of its first block, its number of blocks, and the share that is flown, 0 to 1."""


class Flights(NamedTuple):
    """What an executor is told."""

    queue: BlockQueue
    fly: FlyGroup
    run_limit_s: float
    """Longest wall time of one run; a group whose runs took longer together is given up."""
    stop: Stop
    """Once it returns true no further block begins, and runs under way are told to end."""
    on_under_way: Callable[[UnderWay], None]
    on_remark: Callable[[str], None]
    """Told what a user should know."""
    on_events: Callable[[GroupEvents], None] | None = None
    """Told what happens in runs that fly alone, as far as the executor hears of it."""


class Executor(Protocol):
    """Flies blocks, several at a time."""

    jobs: int
    """How many at a time."""

    def run(self, flights: Flights) -> Iterator[tuple[PlannedBlock, Outcome]]:
        """Fly all blocks of the queue and yield what became of each as it ends; those that were interrupted are not
        yielded. The caller tells the queue of what is finished.
        """
        ...


_POLL_S: Final = 0.2
_STEP: Final = 0.005
"""Share of a run after which a worker tells of its progress."""


class InThisProcess:
    """An `Executor` in this process: what fails can be looked at where it does. There is no limit of time."""

    jobs = 1

    def run(self, flights: Flights) -> Iterator[tuple[PlannedBlock, Outcome]]:
        """See `Executor.run`. Raises the error of what is flown."""
        while not flights.stop() and (group := flights.queue.take()):
            tell = _Shares(group)

            def on_flown(flown: float, tell: _Shares = tell) -> None:
                flights.on_under_way(tell.under_way(flown))

            on_events = None if flights.on_events is None else partial(_tell_events, flights.on_events, group)
            results = flights.fly(group, on_flown, stop=flights.stop, on_events=on_events)
            flights.on_under_way(UnderWay(0.0, 0.0))
            yield from zip(group, results, strict=True)


def _tell_events(tell: Callable[[GroupEvents], None], group: Group, folder: str, report: EventReport) -> None:
    tell(GroupEvents(group[0].name, folder, report))


class _Shares:
    """Runs and work of a group."""

    def __init__(self, group: Group) -> None:
        self._name, self._blocks = group[0].name, len(group)
        self.runs = sum(len(block.folders) for block in group)
        self._work = math.fsum(block.work for block in group)

    def under_way(self, flown: float) -> UnderWay:
        share = flown / self.runs if self.runs else 0.0
        return UnderWay(flown, self._work * share, [(self._name, self._blocks, share)])


class _Ready:
    """A worker's first message: a signal ends its run from now on, and not itself."""


class _Worker:
    """One process, and the group of blocks that it flies."""

    def __init__(self, context: Any, number: int, flights: Flights) -> None:
        self.pipe, far = context.Pipe()
        self._on_events = flights.on_events
        parts = (far, number, flights.fly, os.getpid(), flights.on_events is not None)
        self.process: BaseProcess = context.Process(target=_serve, args=parts, daemon=True)
        self.process.start()
        far.close()
        self.group: list[PlannedBlock] = []
        self.under_way = UnderWay(0.0, 0.0)
        self.began_s = 0.0
        self._ready = self._interrupted = False

    def begin(self, group: list[PlannedBlock]) -> None:
        self.group, self.began_s = group, time.monotonic()
        self.pipe.send(group)

    def receive(self) -> list[BlockResult] | WorkerFailure | ShortfallError | None:
        """What became of the group, after which the worker has none; `None` if it is still under way.

        Raises any other `SkyrangeError` of the worker.
        """
        try:
            message = self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            code = self.process.exitcode or 0
            reason = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
            return WorkerFailure(f"its process was ended {reason}")
        if isinstance(message, _Ready):
            self._ready = True
            return None
        if isinstance(message, GroupEvents):
            if self._on_events is not None:
                self._on_events(message)
            return None
        if isinstance(message, float):
            self.under_way = _Shares(self.group).under_way(message)
            return None
        if isinstance(message, SkyrangeError) and not isinstance(message, ShortfallError):
            raise message
        assert isinstance(message, (list, ShortfallError))
        return message

    def release(self) -> list[PlannedBlock]:
        """Take the group from the worker, which has ended it."""
        group, self.group, self.under_way = self.group, [], UnderWay(0.0, 0.0)
        return group

    def interrupt(self) -> None:
        """Tell a worker that flies to end its run, once and not before it obeys."""
        if self._ready and not self._interrupted and self.process.is_alive() and self.process.pid is not None:
            self._interrupted = True
            os.kill(self.process.pid, signal.SIGINT)

    def end(self) -> None:
        """End the process, at once."""
        self.process.kill()
        self.process.join()
        self.pipe.close()


class LocalPool:
    """An `Executor` of processes of this machine, which stay until all is flown; one that dies is replaced."""

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs

    def run(self, flights: Flights) -> Iterator[tuple[PlannedBlock, Outcome]]:
        """See `Executor.run`. Raises the `SkyrangeError` that a worker raises, such as for a full disk."""
        forks = "fork" in multiprocessing.get_all_start_methods()
        context: Any = multiprocessing.get_context("fork" if forks else "spawn")
        queue = flights.queue
        workers = [_Worker(context, number, flights) for number in range(min(self.jobs, queue.left))]
        try:
            while True:
                stopped = flights.stop()
                for worker in workers:
                    if stopped and worker.group:
                        worker.interrupt()
                    elif not stopped and not worker.group and (group := queue.take()):
                        worker.begin(group)
                flying = {worker.pipe: worker for worker in workers if worker.group}
                if not flying:
                    return
                for ready in wait(list(flying), timeout=_POLL_S):
                    assert isinstance(ready, Connection)
                    worker = flying[ready]
                    outcome = worker.receive()
                    if outcome is None:
                        continue
                    group = worker.release()
                    flights.on_under_way(_add_up(workers))
                    if isinstance(outcome, WorkerFailure):
                        self._replace(workers, worker, context, flights)
                        yield from _give_up(flights, group, outcome)
                    elif isinstance(outcome, list):
                        yield from zip(group, outcome, strict=True)
                    elif not stopped and not flights.stop():
                        raise outcome
                for worker in [busy for busy in workers if busy.group]:
                    limit_s = flights.run_limit_s * _Shares(worker.group).runs
                    if time.monotonic() - worker.began_s > limit_s:
                        group = worker.release()
                        flights.on_under_way(_add_up(workers))
                        self._replace(workers, worker, context, flights)
                        late = WorkerFailure(f"took longer than {limit_s:g} s; its process was ended")
                        yield from _give_up(flights, group, late)
                flights.on_under_way(_add_up(workers))
        finally:
            for worker in workers:
                worker.end()

    @staticmethod
    def _replace(workers: list[_Worker], worker: _Worker, context: Any, flights: Flights) -> None:
        number = workers.index(worker)
        worker.end()
        workers[number] = _Worker(context, number, flights)


def _add_up(workers: Sequence[_Worker]) -> UnderWay:
    parts = [worker.under_way for worker in workers]
    groups = [group for part in parts for group in part.groups]
    return UnderWay(math.fsum(part.runs for part in parts), math.fsum(part.work for part in parts), groups)


def _give_up(flights: Flights, group: Group, why: WorkerFailure) -> Iterator[tuple[PlannedBlock, Outcome]]:
    """The failure of a block; of several that a worker had together each is flown again, to find the one at fault."""
    if len(group) > 1:
        flights.on_remark(f"a worker with {len(group)} blocks failed: {why}; each of them is flown again by itself")
        flights.queue.fly_alone(group)
        return
    yield from ((block, why) for block in group)


def _serve(pipe: Connection, number: int, fly: FlyGroup, parent: int, observed: bool) -> None:  # noqa: FBT001
    """Main function of a process."""
    end_with_parent(parent)
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)  # Ctrl-C reaches the parent alone
    if sys.platform == "linux":
        cpus = available_cpus()
        os.sched_setaffinity(0, {cpus[number % len(cpus)]})
    collect_less()
    with Interruptible() as interrupt:
        pipe.send(_Ready())
        while True:
            try:
                group = pipe.recv()
            except (EOFError, OSError):
                return
            last_reported = 0.0

            def tell(flown: float) -> None:
                nonlocal last_reported
                if flown >= last_reported + _STEP:
                    last_reported = flown
                    pipe.send(flown)

            try:
                on_events = partial(_tell_events, pipe.send, group) if observed else None
                result: object = fly(group, tell, stop=lambda: interrupt.requested, on_events=on_events)
            except SkyrangeError as error:
                result = error
            except Exception as error:
                names = ", ".join(block.name for block in group)
                result = ComponentError("study", f"block {names}: {error!r}")
            pipe.send(result)


_RAY_POLL_S: Final = 0.5
_RETRIES: Final = 3
"""How often Ray starts a block again whose worker or node died."""


class RayPool:
    """An `Executor` on the nodes of a Ray cluster, which all see the plan's folder under the same path."""

    def __init__(self, address: str) -> None:
        """Connect to the cluster at `address`, such as "auto" or "ray://head:10001"; "local" starts one here.

        Raises `InputError` without ray, `ComponentError` if the cluster does not answer.
        """
        try:
            ray: Any = import_module("ray")
        except ImportError as error:
            hint = describe_install("scale")
            raise InputError.one("study", "--on", address, "ray, which is not installed", hint) from error
        self._ray = ray
        try:
            if not ray.is_initialized():
                where = {} if address == "local" else {"address": address}
                ray.init(log_to_driver=False, include_dashboard=False, **where)
        except Exception as error:  # ray raises exceptions of many packages
            raise ComponentError("ray", f"cannot connect to {address}: {error}") from error
        self.jobs = max(int(ray.cluster_resources().get("CPU", 1)), 1)

    def run(self, flights: Flights) -> Iterator[tuple[PlannedBlock, Outcome]]:
        """See `Executor.run`. As many groups are submitted as the cluster has CPUs, so that each begins at once; once
        `stop` returns true those under way are cancelled.
        """
        ray, queue = self._ray, flights.queue
        task = ray.remote(num_cpus=1, max_retries=_RETRIES)(_fly_with)
        flying: dict[Any, tuple[Group, float]] = {}
        shared = ray.put(flights.fly)
        try:
            while not flights.stop():
                while len(flying) < self.jobs and (group := queue.take()):
                    flying[task.remote(shared, group)] = group, time.monotonic()
                if not flying:
                    return
                ended, _ = ray.wait(list(flying), num_returns=1, timeout=_RAY_POLL_S)
                for reference in ended:
                    done, _ = flying.pop(reference)
                    outcome = self._take(reference)
                    if isinstance(outcome, WorkerFailure):
                        yield from _give_up(flights, done, outcome)
                    else:
                        yield from zip(done, outcome, strict=True)
                for reference, (late, began_s) in list(flying.items()):
                    limit_s = flights.run_limit_s * _Shares(late).runs
                    if time.monotonic() - began_s > limit_s:
                        del flying[reference]
                        ray.cancel(reference, force=True)
                        why = WorkerFailure(f"took longer than {limit_s:g} s; its task was cancelled")
                        yield from _give_up(flights, late, why)
        finally:
            for reference in flying:
                ray.cancel(reference, force=True)

    def _take(self, reference: Any) -> list[BlockResult] | WorkerFailure:
        try:
            results: list[BlockResult] = self._ray.get(reference)
        except SkyrangeError:
            raise
        except Exception as error:  # ray.exceptions: a dead worker, node or task
            cause = getattr(error, "cause", None)
            if isinstance(cause, SkyrangeError):
                raise cause from error
            return WorkerFailure(f"{type(error).__name__}: {error}".splitlines()[0])
        return results


def _fly_with(fly: FlyGroup, group: Group) -> list[BlockResult]:
    """Fly blocks in a worker of the cluster, which loads the compiled functions for its first ones."""
    collect_less()
    return fly(group)
