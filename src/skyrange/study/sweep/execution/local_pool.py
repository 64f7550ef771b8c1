"""Pool of processes of this machine, one for each CPU, that stays when one of them is killed.

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
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Final

from skyrange.core.errors import ComponentError, SkyrangeError
from skyrange.io.processes.program import end_with_parent
from skyrange.runtime.cores.division import available_cpus
from skyrange.runtime.memory import collect_less
from skyrange.study.sweep.block_files import BlockResult
from skyrange.study.sweep.design.blocks import Block
from skyrange.study.sweep.execution.executors import FlyBlock, Outcome, WorkerFailure

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
