"""Executors of blocks: a pool of processes of this machine, one for each CPU, or tasks of a Ray cluster.

Processes are forked where the system can, after the compiled functions were loaded, so that these are in memory once
and plugins are known. Each is pinned to a CPU. On Linux they end with the process that started them.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Final, Protocol

from skyrange.core.errors import ComponentError, InputError, SkyrangeError
from skyrange.io.processes.program import end_with_parent
from skyrange.runtime.cores.division import available_cpus
from skyrange.runtime.memory import collect_less
from skyrange.study.design.blocks import Block
from skyrange.study.folder import BlockResult


class WorkerFailure(str):
    """Why a block has no result: its worker was killed, or took too long."""

    __slots__ = ()


Outcome = BlockResult | WorkerFailure
FlyBlock = Callable[[Block], BlockResult]


class Executor(Protocol):
    """Flies blocks, several at a time."""

    jobs: int
    """How many at a time."""

    def run(
        self, blocks: Sequence[Block], fly: FlyBlock, limit_s: float, stop: Callable[[], bool]
    ) -> Iterator[tuple[Block, Outcome]]:
        """Fly blocks, in any order, and yield what became of each as it ends.

        A block that takes longer than `limit_s` is given up. Once `stop` returns true no further block is begun, and
        those under way are given up where they are: they are not yielded.
        """
        ...


_POLL_S: Final = 0.2


class _Worker:
    """One process, and the block that it flies."""

    def __init__(self, context: Any, number: int, fly: FlyBlock) -> None:
        self.pipe, far = context.Pipe()
        self.process: BaseProcess = context.Process(target=_serve, args=(far, number, fly, os.getpid()), daemon=True)
        self.process.start()
        far.close()
        self.block: Block | None = None
        self.began_s = 0.0

    def begin(self, block: Block) -> None:
        self.block, self.began_s = block, time.monotonic()
        self.pipe.send(block)

    def end(self) -> None:
        """End the process, at once."""
        self.process.kill()
        self.process.join()
        self.pipe.close()


class LocalPool:
    """An `Executor` on this machine."""

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs

    def run(
        self, blocks: Sequence[Block], fly: FlyBlock, limit_s: float, stop: Callable[[], bool]
    ) -> Iterator[tuple[Block, Outcome]]:
        """See `Executor.run`. Raises the `SkyrangeError` that a worker raises, such as for a full disk."""
        forks = "fork" in multiprocessing.get_all_start_methods()
        context: Any = multiprocessing.get_context("fork" if forks else "spawn")
        waiting = list(reversed(blocks))
        workers = [_Worker(context, number, fly) for number in range(min(self.jobs, len(blocks)))]
        try:
            while not stop():
                for worker in workers:
                    if worker.block is None and waiting:
                        worker.begin(waiting.pop())
                flying = {worker.pipe: worker for worker in workers if worker.block is not None}
                if not flying:
                    return
                for ready in wait(list(flying), timeout=_POLL_S):
                    assert isinstance(ready, Connection)
                    worker = flying[ready]
                    block = worker.block
                    assert block is not None
                    outcome = _receive(worker)
                    worker.block = None
                    if isinstance(outcome, WorkerFailure):
                        self._replace(workers, worker, context, fly)
                    yield block, outcome
                for worker in [one for one in workers if one.block is not None]:
                    if time.monotonic() - worker.began_s > limit_s:
                        block = worker.block
                        assert block is not None
                        self._replace(workers, worker, context, fly)
                        yield block, WorkerFailure(f"took longer than {limit_s:g} s; its process was ended")
        finally:
            for worker in workers:
                worker.end()

    @staticmethod
    def _replace(workers: list[_Worker], worker: _Worker, context: Any, fly: FlyBlock) -> None:
        number = workers.index(worker)
        worker.end()
        workers[number] = _Worker(context, number, fly)


def _receive(worker: _Worker) -> Outcome:
    try:
        found = worker.pipe.recv()
    except (EOFError, OSError):
        worker.process.join()
        code = worker.process.exitcode or 0
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
        return WorkerFailure(f"its process was ended {how}")
    if isinstance(found, SkyrangeError):
        raise found
    assert isinstance(found, BlockResult)
    return found


def _serve(pipe: Connection, number: int, fly: FlyBlock, parent: int) -> None:
    """Main function of a process."""
    end_with_parent(parent)
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)  # Ctrl-C reaches the parent alone
    if sys.platform == "linux":
        cpus = available_cpus()
        os.sched_setaffinity(0, {cpus[number % len(cpus)]})
    collect_less()
    while True:
        try:
            block = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            result: object = fly(block)
        except SkyrangeError as error:
            result = error
        except Exception as error:
            result = ComponentError("study", f"block {block.name}: {error!r}")
        pipe.send(result)


_RAY_POLL_S: Final = 0.5
_RETRIES: Final = 3
"""How often Ray starts a block again whose worker or node died."""


class RayPool:
    """An `Executor` on the nodes of a Ray cluster, which all see the study's folder under the same path."""

    def __init__(self, address: str) -> None:
        """Connect to the cluster at `address`, such as "auto" or "ray://head:10001"; "local" starts one here.

        Raises `InputError` without ray, `ComponentError` if the cluster does not answer.
        """
        try:
            ray: Any = import_module("ray")
        except ImportError as error:
            hint = "Install it: pip install 'skyrange[scale]'."
            raise InputError.one("study", "--on", address, "ray, which is not installed", hint) from error
        self._ray = ray
        try:
            if not ray.is_initialized():
                where = {} if address == "local" else {"address": address}
                ray.init(log_to_driver=False, include_dashboard=False, **where)
        except Exception as error:  # ray raises exceptions of many packages
            raise ComponentError("ray", f"cannot connect to {address}: {error}") from error
        self.jobs = max(int(ray.cluster_resources().get("CPU", 1)), 1)

    def run(
        self, blocks: Sequence[Block], fly: FlyBlock, limit_s: float, stop: Callable[[], bool]
    ) -> Iterator[tuple[Block, Outcome]]:
        """See `Executor.run`. As many blocks are submitted as the cluster has CPUs, so that each begins at once."""
        ray = self._ray
        task = ray.remote(num_cpus=1, max_retries=_RETRIES)(_fly_with)
        waiting = list(reversed(blocks))
        flying: dict[Any, tuple[Block, float]] = {}
        shared = ray.put(fly)
        try:
            while not stop():
                while waiting and len(flying) < self.jobs:
                    block = waiting.pop()
                    flying[task.remote(shared, block)] = block, time.monotonic()
                if not flying:
                    return
                ended, _ = ray.wait(list(flying), num_returns=1, timeout=_RAY_POLL_S)
                for one in ended:
                    block, _ = flying.pop(one)
                    yield block, self._take(one)
                for one, (block, began_s) in list(flying.items()):
                    if time.monotonic() - began_s > limit_s:
                        del flying[one]
                        ray.cancel(one, force=True)
                        yield block, WorkerFailure(f"took longer than {limit_s:g} s; its task was cancelled")
        finally:
            for one in flying:
                ray.cancel(one, force=True)

    def _take(self, reference: Any) -> Outcome:
        try:
            found: Outcome = self._ray.get(reference)
        except SkyrangeError:
            raise
        except Exception as error:  # ray.exceptions: a dead worker, node or task
            cause = getattr(error, "cause", None)
            if isinstance(cause, SkyrangeError):
                raise cause from error
            return WorkerFailure(f"{type(error).__name__}: {error}".splitlines()[0])
        return found


def _fly_with(fly: FlyBlock, block: Block) -> BlockResult:
    """Fly a block in a worker of the cluster, which loads the compiled functions for its first one."""
    collect_less()
    return fly(block)
