"""The command line, and nothing else: every command is a few lines over the library."""

from __future__ import annotations

import io
import os
import sys


def main() -> None:
    """Entry point of the `skyrange` command.

    Exit codes: 0 ok, 2 bad input, 3 a component failed, 4 the run fell short of what was asked.
    """
    from skyrange.cli.app import app
    from skyrange.core.errors import SkyrangeError

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that lacks a sign shows "?" for it
    try:
        try:
            app()
        finally:
            sys.stdout.flush()  # here, where it can still be said that there is no room or no reader
    except SkyrangeError as error:
        print(f"skyrange: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except BrokenPipeError:  # the reader of our output (`| head`) has gone
        _forget_output()
        sys.exit(0)
    except OSError as error:
        # a full disk, say, below a report or a redirected output
        _forget_output()
        where = f"{error.filename}: " if error.filename else ""
        print(f"skyrange: {where}{error.strerror or error}", file=sys.stderr)
        sys.exit(2)


def _forget_output() -> None:
    """Send what is still buffered nowhere: Python would try once more as it ends, and complain."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)
