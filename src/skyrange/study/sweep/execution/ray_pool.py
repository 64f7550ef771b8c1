"""Ray cluster as an executor: a task for each block, with retries when a node or a worker dies."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from typing import Any, Final

from skyrange.core.errors import ComponentError, InputError, SkyrangeError
from skyrange.runtime.memory import collect_less
from skyrange.study.sweep.block_files import BlockResult
from skyrange.study.sweep.design.blocks import Block
from skyrange.study.sweep.execution.executors import FlyBlock, Outcome, WorkerFailure

_POLL_S: Final = 0.5
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
                ended, _ = ray.wait(list(flying), num_returns=1, timeout=_POLL_S)
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
