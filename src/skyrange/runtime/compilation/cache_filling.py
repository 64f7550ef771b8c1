"""Filling of the cache of compiled functions, by several processes, before anything is flown.

A function is compiled when those that it calls are done, whose code its process then loads. So nothing is compiled
twice.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from graphlib import CycleError, TopologicalSorter
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path
from typing import Final

from numba import __version__ as numba_version
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from pydantic import JsonValue

from skyrange.core.cache_keys import find_callees
from skyrange.core.compiled import cache_folder, find_cached
from skyrange.io.processes.program import end_with_parent
from skyrange.runtime.compilation.signatures import KERNELS, Kernel, load_kernels, name_function, rebuild_kernel
from skyrange.runtime.cores.division import available_cpus

OnKernel = Callable[[int, int], None]
"""Called before the first kernel and after each: how many are done, and of how many."""

_MAX_JOBS: Final = 8  # more have nothing to do: the longest chain of calls is the limit


def count_kernels() -> tuple[int, int]:
    """How many of the kernels that flights use are in the cache, and how many these are in all."""
    kernels = load_kernels()
    return len(kernels) - len(_find_missing(kernels)), len(kernels)


def is_cold() -> bool:
    """Whether this version has not filled its cache: what is missing after an edit is compiled when called.

    False if there is no folder for a cache, because nothing can then be compiled ahead.
    """
    return bool(cache_folder()) and not _mark().exists()


def fill_cache(jobs: int | None = None, on_kernel: OnKernel | None = None) -> int:
    """Compile the kernels that the cache lacks in `jobs` processes, by default one a core; returns their number.

    A kernel that cannot be compiled, because the list of kernels is old, is left out.
    """
    if not cache_folder():
        return 0
    missing = _find_missing(load_kernels())
    if not missing:
        _set_mark()
        return 0
    if on_kernel is not None:
        on_kernel(0, len(missing))
    jobs = min(jobs or len(available_cpus()), _MAX_JOBS, len(missing))
    forks = "fork" in multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("fork" if forks else "spawn")
    compiled = done = 0
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin, initargs=(os.getpid(),)) as pool:
        for done, is_compiled in enumerate(_compile_in_order(pool, missing, jobs), 1):
            compiled += is_compiled
            if on_kernel is not None:
                on_kernel(done, len(missing))
    if done == len(missing):
        _set_mark()
    return compiled


def _mark() -> Path:
    """The file which says that this version, with this numba, has filled the cache."""
    versions = f"{version('skyrange')} {numba_version} ".encode()
    return Path(cache_folder()) / f"filled-{blake2b(versions + KERNELS.read_bytes(), digest_size=8).hexdigest()}"


def _set_mark() -> None:
    for old in Path(cache_folder()).glob("filled-*"):
        old.unlink(missing_ok=True)
    _mark().touch()


def _find_missing(kernels: Sequence[Kernel]) -> list[Kernel]:
    cached = {function: find_cached(function) for function in {one.function for one in kernels}}
    return [one for one in kernels if one.arguments not in cached[one.function]]


def _compile_in_order(pool: ProcessPoolExecutor, kernels: Sequence[Kernel], jobs: int) -> Iterator[bool]:
    """Compile callees before callers, those with the longest chain of callers first; yields whether each compiles.

    Ends early if a process of the pool ended, for example for want of memory: what is missing is compiled when called.
    """
    sorter, lengths = _sort(sorted({one.function for one in kernels}, key=name_function))
    left = Counter(one.function for one in kernels)
    ready: list[Kernel] = []
    running: dict[Future[bool], Kernel] = {}
    while True:
        freed = set(sorter.get_ready())
        ready += [one for one in kernels if one.function in freed]
        ready.sort(key=lambda one: lengths[one.function])
        while ready and len(running) < jobs:
            kernel = ready.pop()
            running[pool.submit(_compile, kernel.name, kernel.signature)] = kernel
        if not running:
            return
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            function = running.pop(future).function
            left[function] -= 1
            if not left[function]:
                sorter.done(function)
            try:
                yield future.result()
            except BrokenProcessPool:
                return


def _sort(functions: Sequence[Dispatcher]) -> tuple[TopologicalSorter[Dispatcher], dict[Dispatcher, int]]:
    """The functions in the order of calls, and the length of code in the longest chain of callers of each."""
    callees = {one: set(find_callees(one)).intersection(functions) for one in functions}
    while True:
        sorter = TopologicalSorter(callees)
        try:
            sorter.prepare()
            break
        except CycleError as error:  # one of them is compiled together with the other
            callee, caller, *_ = error.args[1]
            callees[caller].remove(callee)
    lengths = dict.fromkeys(functions, 0)
    for caller in reversed(list(TopologicalSorter(callees).static_order())):
        lengths[caller] += len(caller.py_func.__code__.co_code)
        for callee in callees[caller]:
            lengths[callee] = max(lengths[callee], lengths[caller])
    return sorter, lengths


def _begin(parent: int) -> None:
    """Begin a process of the pool: it ends with its parent, and at Ctrl-C without a word."""
    end_with_parent(parent)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _compile(name: str, signature: list[JsonValue]) -> bool:
    kernel = rebuild_kernel(name, signature)
    if kernel is None:
        return False
    try:
        kernel.function.compile(kernel.arguments)
    except (NumbaError, TypeError):  # the list is of a version in which the function took other arguments
        return False
    return True
