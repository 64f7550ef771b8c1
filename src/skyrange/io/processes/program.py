"""Child processes that never outlive their parent, each in a folder of its own; and single runs of other programs.

On Linux the kernel kills a child when the thread that started it ends (prctl(2), PR_SET_PDEATHSIG), so that even
`kill -9` leaves no orphan; on other systems only an orderly end does. Start programs from a thread that stays.
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
import tempfile
import threading
import time
import weakref
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from skyrange.core.errors import ComponentError

OUTPUT = "output.txt"
"""The file in a program's folder with its output, both streams."""
_PR_SET_PDEATHSIG = 1
_PR_SET_TIMERSLACK = 29
_TAIL_BYTES = 4096
MAX_FILES = 65_536
SPARE_FILES = 64
_FILES_BESIDE = 256
"""Files that everything else may open later, beside those asked for."""


def raise_file_limit(files: int, who: str) -> None:
    """Raise the limit of open files so that `files` more can be opened; `ComponentError` if the system forbids it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = len(os.listdir("/dev/fd")) + files + _FILES_BESIDE
    if soft == resource.RLIM_INFINITY or soft >= needed:
        return
    if hard != resource.RLIM_INFINITY and hard < needed:
        raise ComponentError(who, f"needs {needed} open files, and {hard} are allowed", f"Try `ulimit -n {needed}`")
    resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))


def reserve_files() -> None:
    """Raise the limit of open files as far as is allowed, but for `SPARE_FILES` that `spare_files` lends."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = MAX_FILES if hard == resource.RLIM_INFINITY else min(hard, MAX_FILES)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most - SPARE_FILES, hard))


@contextlib.contextmanager
def spare_files() -> Iterator[None]:
    """A context in which `SPARE_FILES` more can be opened, which connections of peers cannot have taken before."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    more = soft + SPARE_FILES if hard == resource.RLIM_INFINITY else min(soft + SPARE_FILES, hard)
    if soft == resource.RLIM_INFINITY or more <= soft:
        yield
        return
    resource.setrlimit(resource.RLIMIT_NOFILE, (more, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def processor_time_s(pid: int) -> float:
    """Processor time of a process, user and system, in seconds; NaN if the system does not report it (/proc)."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return math.nan
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _prctl() -> ctypes.CDLL | None:
    if sys.platform != "linux":
        return None
    try:
        return ctypes.CDLL(None, use_errno=True)
    except OSError:
        return None


def end_with_parent(parent: int) -> None:
    """Let this process, a child of `parent`, end when that does, at once; on Linux alone."""
    library = _prctl()
    if library is not None:
        _bind_to(library, parent)


def _bind_to(library: ctypes.CDLL, parent: int) -> None:
    library.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended in between
        os._exit(1)


class Program:
    """A running child process. Ctrl-C does not reach it: `kill` ends it."""

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        folder: Path,
        *,
        slack_s: float | None = None,
        stdin: int = subprocess.DEVNULL,
        is_wrapper: bool = False,
    ) -> None:
        """Start `command` in `folder`, which exists, with the file descriptor `stdin` as its standard input.

        What a program that `is_wrapper` has started in its process group is killed with it.

        Raises `ComponentError` if it cannot be started.

        With `slack_s` its sleeps may last that much longer than it asks for, on Linux (timer slack), so that a program
        that polls takes less of the processor.
        """
        self.name = name
        self._output = folder / OUTPUT
        library, parent = _prctl(), os.getpid()

        def bind_to_parent() -> None:
            if library is not None:
                _bind_to(library, parent)
                if slack_s is not None:
                    library.prctl(_PR_SET_TIMERSLACK, round(slack_s * 1e9))

        try:
            with spare_files(), self._output.open("wb") as output:
                self._process = subprocess.Popen(  # noqa: S603 (the caller checks what is run)
                    list(command), cwd=folder, stdin=stdin, stdout=output, stderr=subprocess.STDOUT,
                    start_new_session=True, preexec_fn=bind_to_parent,
                )  # fmt: skip
        except OSError as error:
            raise ComponentError(name, f"cannot start {command[0]}: {error.strerror or error}") from error
        # at the latest when it is collected, or at exit
        self._end = weakref.finalize(self, _kill, self._process, is_wrapper=is_wrapper)

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
        """Processor time used, user and system, in seconds; NaN if the system does not report it (/proc)."""
        return processor_time_s(self.pid)

    def last_words(self, lines: int = 8) -> str:
        """The last lines of its output, "" for none."""
        try:
            with self._output.open("rb") as output:
                output.seek(max(0, output.seek(0, os.SEEK_END) - _TAIL_BYTES))
                text = output.read().decode("utf-8", "replace")
        except OSError:
            return ""
        kept = [line for line in text.splitlines() if line.strip()]
        return "\n".join(kept[-lines:])

    def set_stopped(self, *, stopped: bool) -> None:
        """Stop the process (SIGSTOP) if `stopped`, else continue it (SIGCONT). Does nothing once it has ended."""
        if self.running:
            self._process.send_signal(signal.SIGSTOP if stopped else signal.SIGCONT)

    def keep_to(self, cores: set[int]) -> None:
        """Run its main thread on these processor cores from now on, as far as the system allows it (Linux)."""
        if self.running:  # after its end the id may be another process's
            with contextlib.suppress(OSError):
                os.sched_setaffinity(self.pid, cores)

    def kill(self) -> None:
        """Kill it, and wait until it has ended. A second call does nothing."""
        self._end()


class Watchdog:
    """Stops programs on the machine's clock while this process does not serve them: their time must not pass alone.

    The thread that serves them may compile, or wait for a disk; so another thread watches.
    """

    def __init__(self, programs: Sequence[Program], after_s: float) -> None:
        """Watch from now on, and stop `programs` when no `kick` has come for `after_s`."""
        self._programs = tuple(programs)
        self._after_s = after_s
        self._lock = threading.Lock()
        self._kicked_s = time.monotonic()
        self._stopped = False
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="watchdog", daemon=True)
        self._thread.start()

    def kick(self) -> bool:
        """Restart the timeout. True if the programs have been stopped meanwhile: the caller has to continue them."""
        with self._lock:
            self._kicked_s = time.monotonic()
            stopped, self._stopped = self._stopped, False
        return stopped

    def close(self) -> None:
        """Stop watching. A second call does nothing."""
        self._end.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._end.wait(self._after_s / 4):
            with self._lock:
                if not self._stopped and time.monotonic() - self._kicked_s > self._after_s:
                    self._stopped = True
                    for program in self._programs:
                        program.set_stopped(stopped=True)


def _kill(process: subprocess.Popen[bytes], *, is_wrapper: bool) -> None:
    if process.poll() is None:
        if is_wrapper:
            os.killpg(process.pid, signal.SIGKILL)  # it leads a session of its own
        else:
            process.kill()
    process.wait()


MAX_BYTES: Final = 1 << 20
"""No more of the output is read."""

_LOOK_S: Final = 0.005


class ProgramOutput(NamedTuple):
    """How a program ended ("exit 0", "signal SIGSEGV"), and its output, standard error included."""

    ended: str
    text: str


def run_once(program: Path, *arguments: str, deadline_s: float, who: str = "") -> ProgramOutput:
    """Run `program` with `arguments` in an empty folder, which is removed afterwards; its output.

    Raises `ComponentError` in the name of `who` (the program, if not given) if it cannot be started, or has not ended
    after `deadline_s` of wall time; it is killed then, with what it has started.
    """
    who = who or str(program)
    until = time.monotonic() + deadline_s
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            child = Program(who, [str(program), *arguments], folder, is_wrapper=True)
        except ComponentError as error:
            raise ComponentError(who, *_why(program, error.__cause__)) from None
        try:
            while child.running:
                if time.monotonic() > until:
                    call = f"`{' '.join(arguments)}`"
                    raise ComponentError(who, f"did not answer {call} within {deadline_s:g} s of wall time")
                time.sleep(_LOOK_S)
        finally:
            child.kill()
        with (folder / OUTPUT).open("rb") as output:
            return ProgramOutput(child.ended, output.read(MAX_BYTES).decode("utf-8", "replace"))


def _why(program: Path, error: BaseException | None) -> tuple[str, str]:
    """The reason why the program did not start, and a hint."""
    if isinstance(error, FileNotFoundError) and program.exists():
        hint = "On a system with musl (Alpine) programs built for glibc do not run."
        return "the loader that it names is not on this machine", hint
    problem = (isinstance(error, OSError) and error.strerror) or str(error)
    return f"cannot be started: {problem.lower()}", (
        "Is its folder mounted with noexec?" if isinstance(error, PermissionError) else ""
    )
