"""Measurement in a process of its own, spawned, so that it has nothing of the caller's memory."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any

from skyrange.core.errors import ComponentError, SkyrangeError
from skyrange.runtime.memory import collect_less

Row = dict[str, Any]


def run_in_process(name: str, function: Callable[..., Row], *arguments: Any, **keywords: Any) -> Row:
    """Call `function` in a process of its own; its result.

    Raises the `SkyrangeError` that it raises, and `ComponentError` in the name of `name` if the process ends early.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    named = function.__module__, function.__name__
    process = context.Process(target=_send_result, args=(sender, *named, *arguments), kwargs=keywords)
    process.start()
    sender.close()
    try:
        answer: Row | SkyrangeError = receiver.recv()
    except EOFError:
        process.join()
        raise ComponentError(name, f"ended with exit code {process.exitcode}") from None
    process.join()
    if isinstance(answer, SkyrangeError):
        raise answer
    return answer


def _send_result(answer: Connection, module: str, name: str, *arguments: Any, **keywords: Any) -> None:
    collect_less()  # as the command does, before it imports what it runs
    try:
        answer.send(getattr(import_module(module), name)(*arguments, **keywords))
    except SkyrangeError as error:
        answer.send(error)
    answer.close()
