"""Rows of measured runs of a study: cells of points and arms, exact intervals, verdicts on predictions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, TypeVar

from skyrange.statistics.exact_intervals import proportion_interval

Row = dict[str, Any]
"""The measures of a run by name."""
CONFIDENCE: Final = 0.95
_Item = TypeVar("_Item")


def count(rows: Iterable[_Item], holds: Callable[[_Item], bool]) -> int:
    """The number of runs, or of pairs of runs, of which something holds."""
    return sum(1 for row in rows if holds(row))


def format_share(hits: int, trials: int) -> str:
    """A share with its exact interval, in percent."""
    low, high = proportion_interval(hits, trials, CONFIDENCE)
    return f"{hits} of {trials} ({100 * low:.0f} to {100 * high:.0f} %)"


def select(rows: Sequence[Row], **values: Any) -> list[Row]:
    """The runs with these values."""
    return [row for row in rows if all(row[name] == value for name, value in values.items())]


def list_values(rows: Sequence[Row], name: str) -> list[Any]:
    """The different values of a column, in order."""
    return list(dict.fromkeys(row[name] for row in rows))


def format_verdicts(verdicts: Iterable[tuple[str, bool]], start: int = 1) -> list[str]:
    """The table of predictions from number `start` on: what was found, and whether it is as predicted."""
    lines = ["| prediction | found | verdict |", "|---|---|---|"]
    for number, (found, held) in enumerate(verdicts, start):
        lines.append(f"| {number} | {found} | {'as predicted' if held else '**missed**'} |")
    return lines
