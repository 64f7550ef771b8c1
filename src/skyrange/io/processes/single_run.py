"""A single run of another program in an empty folder, with a deadline; its exit and its output."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Final, NamedTuple

from skyrange.core.errors import ComponentError
from skyrange.io.processes.program import OUTPUT, Program

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
