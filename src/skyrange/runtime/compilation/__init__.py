"""Compilation of kernels before they are called: which ones flights use, and how to compile them on all cores.

A function is compiled when those that it calls are done, whose code its process then loads. So nothing is compiled
twice.

A kernel is a compiled function with the types of its arguments. The list, `kernels.json`, is made by
`tools/record_kernels.py`. Records and named tuples are in it by the name of their dtype or class, so that it still fits
when a field is added.
"""

from __future__ import annotations

import importlib
import json
import multiprocessing
import os
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from graphlib import CycleError, TopologicalSorter
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numba import __version__ as numba_version
from numba.core import types
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numba.np.numpy_support import as_dtype, from_dtype
from pydantic import JsonValue

from skyrange.core.compiled import cache_folder, find_cached, find_callees
from skyrange.io.processes.program import end_with_parent

KERNELS: Final = Path(__file__).with_name("kernels.json")
_PACKAGE: Final = __name__.partition(".")[0]


class Kernel(NamedTuple):
    """A compiled function, and the types of its arguments: an entry of the list, and what it stands for."""

    name: str
    signature: list[JsonValue]
    function: Any  # a Dispatcher, which mypy takes for a method
    arguments: tuple[types.Type, ...]


def load_kernels() -> list[Kernel]:
    """The kernels of the list that this version has: a list that is old costs only time."""
    kernels: list[Kernel] = []
    for name, signatures in read_list().items():
        for signature in signatures:
            kernel = rebuild_kernel(name, signature)
            if kernel is not None:
                kernels.append(kernel)
    return kernels


def read_list() -> dict[str, list[list[JsonValue]]]:
    """The list as it is in its file: signatures by `module:function`."""
    listed: dict[str, list[list[JsonValue]]] = json.loads(KERNELS.read_bytes())
    return listed


def write_list(listed: dict[str, list[list[JsonValue]]]) -> None:
    """Write the list in its order: one line a signature."""
    blocks = [
        f"{json.dumps(name)}: [\n  " + ",\n  ".join(sorted(map(json.dumps, signatures))) + "\n]"
        for name, signatures in sorted(listed.items())
    ]
    KERNELS.write_text("{\n" + ",\n".join(blocks) + "\n}\n", encoding="utf-8")


def name_function(function: Dispatcher) -> str:
    """The name of a function in the list."""
    return _name(function.py_func)


def rebuild_kernel(name: str, signature: list[JsonValue]) -> Kernel | None:
    """The kernel of an entry of the list; None if this version has no such function or type."""
    function = _find_function(name)
    if function is None:
        return None
    try:
        return Kernel(name, signature, function, tuple(map(_rebuild, signature)))
    except (ImportError, AttributeError):
        return None


def describe_arguments(arguments: tuple[types.Type, ...]) -> list[JsonValue]:
    """Types of arguments as JSON. Raises `TypeError` for a type that cannot be rebuilt from it."""
    described = [_describe(argument) for argument in arguments]
    if tuple(map(_rebuild, described)) != tuple(arguments):
        raise TypeError(f"{arguments} are other types when rebuilt from {described}")
    return described


def _describe(kind: Any) -> JsonValue:
    if isinstance(kind, types.Literal):
        return {"literal": kind.literal_value}
    if isinstance(kind, types.Number | types.Boolean):
        return str(as_dtype(kind).name)
    if isinstance(kind, types.Record):
        return {"record": _name_record(kind) or _describe_fields(kind)}
    if isinstance(kind, types.NestedArray):
        return {"nested": _describe(kind.dtype), "shape": list(kind.shape)}
    if isinstance(kind, types.Array):
        array: dict[str, JsonValue] = {"array": _describe(kind.dtype), "ndim": kind.ndim, "layout": kind.layout}
        changes = {"readonly": not kind.mutable, "unaligned": not kind.aligned}
        return array | {name: True for name, holds in changes.items() if holds}
    if isinstance(kind, types.BaseTuple):
        of: Any = kind  # numba's base class does not declare the attributes of all its subclasses
        made = {"named": _name(of.instance_class)} if isinstance(kind, types.BaseNamedTuple) else {}
        return made | {"tuple": [_describe(item) for item in of.types]}
    raise TypeError(f"{kind!r} has no description")


def _rebuild(described: Any) -> Any:
    if isinstance(described, str):
        return from_dtype(np.dtype(described))
    if "literal" in described:
        return types.literal(described["literal"])  # type: ignore[no-untyped-call]
    if "record" in described:
        record = described["record"]
        return _find_record(record) if isinstance(record, str) else from_dtype(np.dtype(record))
    if "nested" in described:
        return types.NestedArray(_rebuild(described["nested"]), tuple(described["shape"]))
    if "array" in described:
        return types.Array(
            _rebuild(described["array"]),
            described["ndim"],
            described["layout"],
            readonly="readonly" in described,
            aligned="unaligned" not in described,
        )
    made = _find(described["named"]) if "named" in described else None
    return types.BaseTuple.from_types(tuple(map(_rebuild, described["tuple"])), made)  # type: ignore[no-untyped-call]


def _name_record(kind: types.Record) -> str:
    """The first name of a dtype in a module of the package; "" if it has none."""
    return _name_records().get(kind, "")


@cache
def _find_record(name: str) -> Any:
    return from_dtype(_find(name))


@cache
def _name_records() -> dict[types.Type, str]:
    names: dict[types.Type, str] = {}
    for name, module in sorted(sys.modules.items()):
        if name.partition(".")[0] == _PACKAGE:
            for key, value in vars(module).items():
                if isinstance(value, np.dtype) and value.names:
                    names.setdefault(from_dtype(value), f"{name}:{key}")
    return names


def _describe_fields(kind: types.Record) -> dict[str, JsonValue]:
    """A record of numbers, as numpy takes it."""
    dtype = as_dtype(kind)
    names = list(dtype.names or ())
    return {
        "names": list(names),
        "formats": [str(dtype[name].name) for name in names],
        "offsets": [dtype.fields[name][1] for name in names] if dtype.fields else [],
        "itemsize": dtype.itemsize,
    }


def _find_function(name: str) -> Dispatcher | None:
    try:
        target = _find(name)
    except (ImportError, AttributeError):
        return None
    return target if isinstance(target, Dispatcher) else None


def _name(value: Any) -> str:
    return f"{value.__module__}:{value.__qualname__}"


def _find(name: str) -> Any:
    """What a module of this package has by a name such as `skyrange.core.chance:philox`."""
    module, _, attribute = name.partition(":")
    if module.partition(".")[0] != _PACKAGE:
        raise ImportError(f"{module} is no module of {_PACKAGE}")
    return getattr(importlib.import_module(module), attribute)


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
    if not jobs:
        from skyrange.runtime.cores.division import available_cpus  # loads what makes ranges: half a second

        jobs = len(available_cpus())
    jobs = min(jobs, _MAX_JOBS, len(missing))
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
    cached = {function: find_cached(function) for function in {kernel.function for kernel in kernels}}
    return [kernel for kernel in kernels if kernel.arguments not in cached[kernel.function]]


def _compile_in_order(pool: ProcessPoolExecutor, kernels: Sequence[Kernel], jobs: int) -> Iterator[bool]:
    """Compile callees before callers, those with the longest chain of callers first; yields whether each compiles.

    Ends early if a process of the pool ended, for example for want of memory: what is missing is compiled when called.
    """
    sorter, lengths = _sort(sorted({kernel.function for kernel in kernels}, key=name_function))
    left = Counter(kernel.function for kernel in kernels)
    ready: list[Kernel] = []
    running: dict[Future[bool], Kernel] = {}
    while True:
        freed = set(sorter.get_ready())
        ready += [kernel for kernel in kernels if kernel.function in freed]
        ready.sort(key=lambda kernel: lengths[kernel.function])
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
    callees = {function: set(find_callees(function)).intersection(functions) for function in functions}
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
