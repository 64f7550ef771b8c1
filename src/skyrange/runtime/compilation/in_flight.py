"""Compilations in this process while they happen: how many kernels were compiled when they were called."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from numba.core import event

_COMPILE: Final = "numba:compile"
"""What numba tells of a function that it compiles, and not of one that it loads."""


class Compilations(event.Listener):
    """How many functions were compiled, and how many are being compiled now, with those that these call."""

    def __init__(self) -> None:
        self.finished = 0
        self.under_way = 0

    def on_start(self, event: event.Event) -> None:
        """A function begins to be compiled."""
        self.under_way += 1

    def on_end(self, event: event.Event) -> None:
        """A function has been compiled, or cannot be."""
        self.under_way -= 1
        self.finished += 1


@contextmanager
def watch_compilations() -> Iterator[Compilations]:
    """Count the compilations of this process."""
    compilations = Compilations()
    with event.install_listener(_COMPILE, compilations):
        yield compilations
