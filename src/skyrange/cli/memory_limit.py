"""Command under a limit of its memory (`ulimit -v`): it runs in a child process, whose death its parent explains.

Compiled libraries end a process that gets no more memory without a word of Python: LLVM by `abort`, OpenBLAS by `exit`.
While they are loaded, OpenBLAS may even try for ever, so a limit below `LEAST_BYTES` is refused.
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Final

OUT_OF_MEMORY: Final = "memory: the system gave no more. Use a smaller input, or raise the limit (`ulimit -v`)"
LEAST_BYTES: Final = 1_500_000_000
"""The address space that a command needs for its libraries and a small run: 1.2 GB with four threads of OpenBLAS."""
FAILED: Final = 3
BAD_INPUT: Final = 2
_NOT_OF_SKYRANGE: Final = 1
"""An exit code that no command has: a library called `exit`, or Python could not even report its `MemoryError`."""
_FORWARDED: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_SI_USER: Final = 0
_PR_SET_PDEATHSIG: Final = 1


def run_within_limit(command: Callable[[], int]) -> int:
    """Run `command`, in a child process if the address space of this one is limited; returns its exit code."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY or not hasattr(signal, "sigwaitinfo"):
        return command()
    if limit < LEAST_BYTES:
        expected = f"expected at least {LEAST_BYTES / 1e6:,.0f} MB of address space. Raise the limit (`ulimit -v`)"
        _tell(f"memory: {limit / 1e6:,.0f} MB — {expected}")
        return BAD_INPUT
    signals = {*_FORWARDED, signal.SIGCHLD}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    child = os.fork()
    if child == 0:
        _end_with_parent()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return command()
    code = os.waitstatus_to_exitcode(_wait_for(child, signals))
    signal.pthread_sigmask(signal.SIG_SETMASK, before)
    if code in (_NOT_OF_SKYRANGE, -signal.SIGABRT, -signal.SIGSEGV):
        _tell(OUT_OF_MEMORY)
        return FAILED
    return 128 - code if code < 0 else code


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


def _end_with_parent() -> None:
    """A killed command leaves no process behind."""
    parent = os.getppid()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(FAILED)
