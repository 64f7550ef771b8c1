"""Command line: declarations and handlers of the `skyrange` commands; the work is done by the library."""

from __future__ import annotations

import io
import os
import sys


def main() -> None:
    """Entry point of the `skyrange` command.

    Exit codes: 0 success, 2 bad input, 3 a component failed, 4 the run fell short of what was requested.
    """
    from skyrange.cli.app import app
    from skyrange.core.errors import SkyrangeError

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without a character shows "?" for it
    try:
        try:
            app()
        finally:
            sys.stdout.flush()  # here, so that a full disk or a closed pipe can still be reported
    except SkyrangeError as error:
        print(f"skyrange: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except BrokenPipeError:  # the reader of the output (`| head`) has ended
        _discard_output()
        sys.exit(0)
    except OSError as error:
        # for example, a full disk when a report or redirected output is written
        _discard_output()
        where = f"{error.filename}: " if error.filename else ""
        print(f"skyrange: {where}{error.strerror or error}", file=sys.stderr)
        sys.exit(2)


def _discard_output() -> None:
    """Discard buffered output, because Python would try to write it on exit and report the error a second time."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)
