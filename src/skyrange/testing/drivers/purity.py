"""Purity watch: every call of simulated code is seen, and those that reach outside are stopped.

`sys.setprofile` shows each call of a Python or C function of this thread before it is made, however it
was imported. Forbidden ones are noted and stopped; being noted, they are found even where the
component swallows what stops them. Calls that C code makes by itself (`map(time.time, …)`, numpy's own
generators) are not seen: their results differ from one instance to the next, which other rules show.

Watch a second run only: a first one imports, compiles and opens caches, which is nobody's fault.
"""

from __future__ import annotations

import contextlib
import gc
import random
import socket
import sys
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any, ParamSpec, Protocol, TypeVar

from skyrange.testing.rules import Broken

P = ParamSpec("P")
R = TypeVar("R")

_CLOCK = (
    "time time_ns monotonic monotonic_ns perf_counter perf_counter_ns process_time process_time_ns thread_time "
    "thread_time_ns clock_gettime clock_gettime_ns localtime"
)
_FORBIDDEN: dict[tuple[str, str], str] = {
    **{("time", name): "the clock" for name in _CLOCK.split()},
    ("time", "sleep"): "sleep",
    ("_thread", "start_new_thread"): "a thread",
    ("io", "open"): "a file",
    ("posix", "urandom"): "unaddressed chance",
}
"""C functions by (module, name) → what they reach for."""
_MODULES = {
    "posix": "the operating system",
    "nt": "the operating system",
    "_socket": "a socket",
    "_ssl": "a socket",
    "select": "a socket",
    "_posixsubprocess": "a process",
    "_winapi": "a process",
    "mmap": "a file",
}
"""Modules whose C functions are all forbidden, but for `_HARMLESS`."""
_HARMLESS = frozenset({"fspath", "getpid"})
_DATES = frozenset({"now", "utcnow", "today"})
_SOCKET_INIT = socket.socket.__init__.__code__


class Call(Protocol):
    """How a component's method is called: plainly, or watched."""

    def __call__(self, method: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
        """Call `method`."""
        ...


def plainly(method: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
    """Just call it."""
    return method(*args, **kwargs)


def watched(method: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
    """Call it; `Broken` (rule `pure`) where it, or what it calls, reaches outside."""
    calls: list[str] = []
    try:
        with _watch(calls):
            result = method(*args, **kwargs)
    except _Reached:
        pass
    except Exception:
        if not calls:
            raise
    if calls:
        raise Broken(f"reached for {calls[0]}", "time and frames passed in, outputs returned, nothing else", "pure")
    return result


class _Reached(BaseException):
    """Stops a forbidden call. Not an `Exception`: a component that catches those must not keep it."""


@contextlib.contextmanager
def _watch(violations: list[str]) -> Iterator[None]:
    def look(frame: FrameType, event: str, function: Any) -> None:
        if event == "c_call":
            what = _what(function)
        elif event == "call" and frame.f_code is _SOCKET_INIT:
            what = "a socket"
        else:
            return
        if what:
            name = getattr(function, "__qualname__", frame.f_code.co_qualname)
            caller = frame if event == "c_call" else frame.f_back or frame
            violations.append(f"{what}: {name} called at {caller.f_code.co_filename}:{caller.f_lineno}")
            raise _Reached

    before = sys.getprofile()
    collecting = gc.isenabled()
    gc.disable()  # a finaliser of somebody else's object is not the component's act
    sys.setprofile(look)
    try:
        yield
    finally:
        sys.setprofile(before)
        if collecting:
            gc.enable()


def _what(function: Any) -> str | None:
    """What a C function reaches for; `None` for the harmless."""
    name = function.__name__
    module = getattr(function, "__module__", None)
    if module is None:  # a method
        owner = getattr(function, "__self__", None)
        if name in _DATES and isinstance(owner, type) and owner.__module__ == "datetime":
            return "the clock"
        if isinstance(owner, random.Random):
            return "unaddressed chance"
        return "a socket" if isinstance(owner, socket.socket) else None
    what = _FORBIDDEN.get((module, name))
    if what is None and module in _MODULES and name not in _HARMLESS:
        what = _MODULES[module]
    return what
