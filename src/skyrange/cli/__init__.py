"""Command line: the `skyrange` commands, which call the library and print what it returns."""

from __future__ import annotations

import os
import sys

TRACEBACK_VARIABLE = "SKYRANGE_TRACEBACK"
"""If this environment variable is set, an error that skyrange did not foresee is printed with its traceback."""

_OF_TYPER = (1, 4, 130)
"""Exit codes of typer for a command that `KeyboardInterrupt` ends, and of this one."""


def main() -> None:
    """Entry point of the `skyrange` command.

    Exit codes: 0 success, 2 bad input, 3 a component failed, 4 the command fell short of what was requested, also
    because SIGINT, SIGTERM or SIGHUP ended it.
    """
    from skyrange.cli.memory_limit import run_within_limit

    sys.exit(run_within_limit(_run_until_signal))


def _run_until_signal() -> int:
    """Run the command, which signals end; returns the exit code."""
    from skyrange.cli.signals import INTERRUPTED, EndingSignals

    signals = EndingSignals()
    with signals:
        try:
            code = _run()
        except KeyboardInterrupt:
            code = INTERRUPTED
        if signals.received is not None and code in _OF_TYPER:
            code = _report_signal(signals.received.name)
    return code


def _run() -> int:
    """Run the command with standard streams that survive their readers; returns the exit code."""
    from skyrange.cli.output.standard_streams import open_standard_streams
    from skyrange.runtime.memory import collect_less

    collect_less()  # modules and scenarios are many objects, and hardly any garbage
    open_standard_streams()
    code = _run_command()
    try:
        sys.stdout.flush()
    except OSError as error:  # a full disk behind redirected output
        from skyrange.cli.output.standard_streams import discard_output

        discard_output(1)  # because Python would try to write it on exit and report the error a second time
        code = code or _report(error)
    return code


def _report_signal(name: str) -> int:
    """Say that a signal ended the command; returns the exit code."""
    from skyrange.cli.output.console import print_notice
    from skyrange.cli.signals import INTERRUPTED

    print_notice(f"skyrange: interrupted by {name}")
    return INTERRUPTED


def _run_command() -> int:
    """Run the command that the arguments name, report its error; returns the exit code."""
    from skyrange.cli.app import app

    try:
        code = app(prog_name="skyrange", standalone_mode=False)
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except Exception as error:
        return _report(error)
    return code if isinstance(code, int) else 0


def _report(error: Exception) -> int:
    """Print an error in one line, or one line per problem; returns its exit code."""
    from skyrange.cli.output.console import print_notice
    from skyrange.cli.output.error_messages import describe_error

    if os.environ.get(TRACEBACK_VARIABLE):
        import traceback

        print_notice("".join(traceback.format_exception(error)).rstrip())
    text, code = describe_error(error)
    if text:
        print_notice(text)
    return code
