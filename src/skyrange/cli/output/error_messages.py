"""Messages and exit codes of errors that end a command."""

from __future__ import annotations

import errno

import typer

from skyrange.cli.memory_limit import OUT_OF_MEMORY
from skyrange.core.errors import SkyrangeError
from skyrange.core.extras import find_extra, missing_module

_BAD_INPUT, _FAILED = 2, 3
_NO_MEMORY_SIGNS = (
    "cannot allocate memory", "failed to map segment", "can't start new thread", "failed to launch worker thread",
    "out of memory",
)  # fmt: skip
"""What libraries say if the system gives no memory; they use errors of other kinds."""


def describe_error(error: Exception) -> tuple[str, int]:
    """The message of an error that ends a command ("" for none), and the exit code."""
    if isinstance(error, typer.Abort):
        return "skyrange: aborted", 1
    usage = getattr(error, "format_message", None)
    if callable(usage):  # of typer: an option or argument that is not known, or has a wrong value
        message = str(usage()).replace(": Value error, ", ": ", 1)  # the words of the library that checks options
        return _describe_usage(error, message), int(getattr(error, "exit_code", _BAD_INPUT))
    if isinstance(error, SkyrangeError):
        return "\n".join([f"skyrange: {error}", *getattr(error, "__notes__", ())]), error.exit_code
    if isinstance(error, ModuleNotFoundError) and error.name and (extra := find_extra(error.name)):
        return f"skyrange: {missing_module(error.name, extra, 'import')}", _BAD_INPUT
    if _is_out_of_memory(error):
        return f"skyrange: {OUT_OF_MEMORY}", _FAILED
    if isinstance(error, OSError):  # for example, a full disk when a report or redirected output is written
        where = f"{error.filename}: " if error.filename else ""
        return f"skyrange: {where}{error.strerror or error}", _BAD_INPUT
    hint = "Set SKYRANGE_TRACEBACK=1 to see where, and report it"
    return f"skyrange: {type(error).__name__}: {error} — a defect of skyrange. {hint}", _FAILED


def _describe_usage(error: Exception, message: str) -> str:
    if type(error).__name__ == "NoArgsIsHelpError":  # the help was printed, or is the message
        return message
    context = getattr(error, "ctx", None)
    if context is None:
        return f"skyrange: {message}"
    return f"{context.get_usage()}\nskyrange: {message}\nTry `{context.command_path} --help`."


def _is_out_of_memory(error: BaseException | None) -> bool:
    while error is not None:
        text = str(error).lower()
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
            return True
        foreign = isinstance(error, ImportError | RuntimeError | OSError) or type(error).__name__ == "ArrowException"
        if foreign and any(sign in text for sign in _NO_MEMORY_SIGNS):
            return True
        error = error.__cause__ or error.__context__
    return False
