"""How is another program run so that it never outlives us? In a folder of its own, killed with whoever began it.

On Linux the kernel kills a child when the thread that started it ends (prctl(2), PR_SET_PDEATHSIG), so that even
`kill -9` leaves no orphan; elsewhere only an orderly end does. Start programs from a thread that stays.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import resource
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Sequence
from pathlib import Path

from skyrange.core.errors import ComponentError

OUTPUT = "output.txt"
"""What a program says, both streams, in its folder."""
_PR_SET_PDEATHSIG = 1
_PR_SET_TIMERSLACK = 29
_TAIL_BYTES = 4096
_FILES_BESIDE = 256
"""Files that everything else may open later."""


def make_room(files: int, who: str) -> None:
    """See to it that so many more files and sockets can be open; `ComponentError` where the system forbids it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = len(os.listdir("/dev/fd")) + files + _FILES_BESIDE
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise ComponentError(who, f"needs {needed} open files, and {hard} are allowed", f"Try `ulimit -n {needed}`")
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))


def _prctl() -> ctypes.CDLL | None:
    if sys.platform != "linux":
        return None
    try:
        return ctypes.CDLL(None, use_errno=True)
    except OSError:
        return None


class Program:
    """A running child process. Its keyboard is closed, and Ctrl-C on ours does not reach it: it is ended by `kill`."""

    def __init__(self, name: str, command: Sequence[str], folder: Path, *, slack_s: float | None = None) -> None:
        """Start `command` in `folder`, which exists. `ComponentError` where it cannot be started.

        With `slack_s` its sleeps may last so much longer than it asks for, on Linux: one that polls takes less of the
        processor.
        """
        self.name = name
        self._output = folder / OUTPUT
        library, parent = _prctl(), os.getpid()

        def bind_to_us() -> None:
            if library is not None:
                library.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
                if slack_s is not None:
                    library.prctl(_PR_SET_TIMERSLACK, round(slack_s * 1e9))
                if os.getppid() != parent:  # we died in between
                    os._exit(1)

        try:
            with self._output.open("wb") as output:
                self._process = subprocess.Popen(  # noqa: S603 (what is run is the caller's to check)
                    list(command), cwd=folder, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                    start_new_session=True, preexec_fn=bind_to_us,
                )  # fmt: skip
        except OSError as error:
            raise ComponentError(name, f"cannot start {command[0]}: {error.strerror or error}") from error
        self._end = weakref.finalize(self, _kill, self._process)  # at the latest when nobody holds it, or at exit

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self._process.poll() is None

    @property
    def ended(self) -> str:
        """How it ended, such as "exit 1" or "signal SIGKILL"; "" while it runs."""
        code = self._process.poll()
        if code is None:
            return ""
        if code >= 0:
            return f"exit {code}"
        try:
            return f"signal {signal.Signals(-code).name}"
        except ValueError:
            return f"signal {-code}"

    @property
    def cpu_s(self) -> float:
        """Processor time that it has taken, user and system, in seconds; NaN where the system does not tell (/proc)."""
        try:
            told = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return math.nan
        return (int(told[11]) + int(told[12])) / os.sysconf("SC_CLK_TCK")

    def last_words(self, lines: int = 8) -> str:
        """The last lines that it said, "" for none."""
        try:
            with self._output.open("rb") as output:
                output.seek(max(0, output.seek(0, os.SEEK_END) - _TAIL_BYTES))
                said = output.read().decode("utf-8", "replace")
        except OSError:
            return ""
        kept = [line for line in said.splitlines() if line.strip()]
        return "\n".join(kept[-lines:])

    def hold(self, held: bool) -> None:
        """Stop its time, or let it go on; one that has ended stays so."""
        if self.running:
            self._process.send_signal(signal.SIGSTOP if held else signal.SIGCONT)

    def keep_to(self, cores: set[int]) -> None:
        """Run its main thread on these processor cores from now on, as far as the system lets us (Linux)."""
        if self.running:  # the id of one that has ended may be another's
            with contextlib.suppress(OSError):
                os.sched_setaffinity(self.pid, cores)

    def kill(self) -> None:
        """End it now, and wait until it has. Again does nothing."""
        self._end()


class Leash:
    """Programs on the machine's clock, stopped where we are silent for too long: their time must not pass without us.

    We compile, or wait for a disk, in the one thread that speaks with them; so another keeps watch.
    """

    def __init__(self, programs: Sequence[Program], after_s: float) -> None:
        """Watch from now on; each `tug` says that we are here."""
        self._programs = tuple(programs)
        self._after_s = after_s
        self._lock = threading.Lock()
        self._tugged_s = time.monotonic()
        self._stopped = False
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="leash", daemon=True)
        self._thread.start()

    def tug(self) -> bool:
        """We are here. True where all have been stopped meanwhile: letting them go on is the caller's."""
        with self._lock:
            self._tugged_s = time.monotonic()
            stopped, self._stopped = self._stopped, False
        return stopped

    def close(self) -> None:
        """Watch no more. Again does nothing."""
        self._end.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._end.wait(self._after_s / 4):
            with self._lock:
                if not self._stopped and time.monotonic() - self._tugged_s > self._after_s:
                    self._stopped = True
                    for program in self._programs:
                        program.hold(True)


def _kill(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.kill()
    process.wait()
