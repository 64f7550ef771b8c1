"""Missions that failed without an attack, on the terminal."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def print_failed_missions(console: Console, lines: Iterable[str]) -> None:
    """Print a line for each run; commands do so first, because effects are differences from these runs."""
    for line in lines:
        text = f"failed without an attack: {line}"
        console.print(text, style="yellow", soft_wrap=True, markup=False, highlight=False)
