"""What does another program say when it is run once, in an empty folder, with little patience?"""

from __future__ import annotations

import os
import selectors
import subprocess
import tempfile
import time
from pathlib import Path
from typing import IO, Final, NamedTuple

from skyrange.core.errors import ComponentError

MOST_BYTES: Final = 1 << 20
"""Of an answer no more than this is read."""


class Answer(NamedTuple):
    """How a program ended and what it printed, standard error among it; a negative code is the signal that ended it."""

    code: int
    text: str


def ask(program: Path, *arguments: str, deadline_s: float, who: str = "") -> Answer:
    """Run `program` with `arguments` in an empty folder that is gone afterwards, and read what it prints.

    Raises `ComponentError`, blaming `who` (the program, if not given), if it cannot be started, or has not ended after
    `deadline_s` of wall time; it is killed then.
    """
    who = who or str(program)
    until = time.monotonic() + deadline_s
    with tempfile.TemporaryDirectory() as folder:
        try:
            child = subprocess.Popen(  # noqa: S603 - the program that the user named
                [program, *arguments],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=folder,
            )  # fmt: skip
        except FileNotFoundError:
            hint = "On a system with musl (Alpine) programs built for glibc do not run."
            problem = "the loader that it names is not on this machine" if program.exists() else "is not there"
            raise ComponentError(who, problem, hint if program.exists() else "") from None
        except OSError as error:
            hint = "Is its folder mounted with noexec?" if isinstance(error, PermissionError) else ""
            raise ComponentError(who, f"cannot be started: {(error.strerror or str(error)).lower()}", hint) from None
        with child:
            try:
                assert child.stdout is not None
                text = _read(child.stdout, until)
                code = child.wait(max(0.0, until - time.monotonic()))
            except (TimeoutError, subprocess.TimeoutExpired):
                said = f"`{' '.join(arguments)}`"
                raise ComponentError(who, f"did not answer {said} within {deadline_s:g} s of wall time") from None
            finally:
                child.kill()
    return Answer(code, text.decode("utf-8", "replace"))


def _read(pipe: IO[bytes], until: float) -> bytes:
    """All that comes before the pipe's end, at most `MOST_BYTES`."""
    text = b""
    with selectors.DefaultSelector() as selector:
        selector.register(pipe, selectors.EVENT_READ)
        while len(text) < MOST_BYTES:
            if not selector.select(max(0.0, until - time.monotonic())):
                raise TimeoutError
            piece = os.read(pipe.fileno(), 65_536)
            if not piece:
                break
            text += piece
    return text
