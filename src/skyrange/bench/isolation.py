"""Measurement in a process of its own, spawned, so that it has nothing of the caller's memory."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from skyrange.core.errors import ComponentError, SkyrangeError

Row = dict[str, Any]


def run_in_process(name: str, function: Callable[..., Row], *arguments: Any) -> Row:
    """Call `function` in a process of its own; its result.

    Raises the `SkyrangeError` that it raises, and `ComponentError` in the name of `name` if the process ends early.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send_result, args=(sender, function, *arguments))
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


def _send_result(answer: Connection, function: Callable[..., Row], *arguments: Any) -> None:
    try:
        answer.send(function(*arguments))
    except SkyrangeError as error:
        answer.send(error)
    answer.close()
