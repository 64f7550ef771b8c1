"""Command under a limit of its memory (`ulimit -v`): it runs in a child process, whose death its parent explains.

Compiled libraries end a process that gets no more memory without a word of Python: LLVM by `abort`, OpenBLAS by `exit`.
While they are loaded, OpenBLAS may even try for ever, so a limit below `LEAST_BYTES` is refused.
"""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Callable
from contextlib import suppress
from typing import Final

OUT_OF_MEMORY: Final = "memory: the system gave no more. Use a smaller input, or raise the limit (`ulimit -v`)"
LEAST_BYTES: Final = 1_500_000_000
"""The address space that a command needs for its libraries and a small run: 1.2 GB with four threads of OpenBLAS."""
_FORWARDED: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_OF_LIBRARIES: Final = (signal.SIGABRT, signal.SIGBUS, signal.SIGSEGV)
"""Signals that end a process for want of memory; others were sent to it."""
_SI_USER: Final = 0


def run_within_limit(command: Callable[[], int]) -> int:
    """Run `command`, in a child process if the address space of this one is limited; returns its exit code."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY or not hasattr(signal, "sigwaitinfo"):
        return command()
    from skyrange.core.errors import ComponentError, InputError

    if limit < LEAST_BYTES:
        expected = f"at least {LEAST_BYTES / 1e6:,.0f} MB of address space"
        _tell(str(InputError.one("memory", "limit", f"{limit / 1e6:,.0f} MB", expected, "Raise it (`ulimit -v`).")))
        return InputError.exit_code
    ended, returned = os.pipe()  # only a command that returns writes to it
    signals = {*_FORWARDED, signal.SIGCHLD}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        from skyrange.io.processes.program import end_with_parent

        end_with_parent(parent)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        code = command()
        os.write(returned, b"\0")
        return code
    code = os.waitstatus_to_exitcode(_wait_for(child, signals))
    signal.pthread_sigmask(signal.SIG_SETMASK, before)
    os.set_blocking(ended, False)
    with suppress(BlockingIOError):  # nothing is there, and a process that outlives the child has its end open
        if os.read(ended, 1):
            return code
    if code > 0 or -code in _OF_LIBRARIES:
        _tell(OUT_OF_MEMORY)
        return ComponentError.exit_code
    return 128 - code


def _tell(text: str) -> None:
    """Print without the modules of the console, for which the memory may not be enough."""
    with suppress(OSError):
        os.write(2, f"skyrange: {text}\n".encode())


def _wait_for(child: int, signals: set[signal.Signals]) -> int:
    """The status with which the child ended; what one sends to this process reaches the child.

    A terminal sends its signals to both, so those are not forwarded.
    """
    while True:
        received = signal.sigwaitinfo(signals)
        if received.si_signo != signal.SIGCHLD:
            if received.si_code == _SI_USER:
                os.kill(child, received.si_signo)
            continue
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended == child:
            return status
