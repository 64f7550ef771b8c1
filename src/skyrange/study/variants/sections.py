"""Tables of a comparison of variants: each measure of each variant, and the delays of each operator."""

from __future__ import annotations

from typing import NamedTuple

from skyrange.statistics.means import Interval
from skyrange.study.variants.flights import Comparison
from skyrange.study.variants.run_measures import QUANTITIES


class Table(NamedTuple):
    """One table."""

    title: str
    head: list[str]
    rows: list[list[str]]
    notes: list[str]
    """What each row is about, for those who ask."""


def make_tables(result: Comparison) -> list[Table]:
    """The measures that differ somewhere or are not zero, and the delays."""
    variants = list(result.changes)
    rows, notes = [], []
    for one in QUANTITIES:
        means = [result.interval(variant, one.name) for variant in variants]
        if not any(mean is not None and mean.mean for mean in means):
            continue
        rows.append([f"{one.name} ({one.unit})" if one.unit else one.name, *map(format_interval, means)])
        notes.append(one.about)
    tables = [Table("Measures", ["measure", *variants], rows, notes)]
    delays = {variant: result.delays_s(variant) for variant in variants}
    operators = list(dict.fromkeys(name for own in delays.values() for name in own))
    if any(mean.mean for own in delays.values() for mean in own.values()):
        rows = [[name, *(format_interval(delays[variant].get(name)) for variant in variants)] for name in operators]
        title = "Mean delay of the approved flights of each operator (s)"
        tables.append(Table(title, ["operator", *variants], rows, [""] * len(rows)))
    return tables


def format_interval(mean: Interval | None) -> str:
    """A mean with its interval, or why it has none."""
    if mean is None:
        return "–"
    if mean.n == 1:
        return _number(mean.mean)
    if mean.low is None or mean.high is None:
        return f"{_number(mean.mean)} ({mean.without})"
    return f"{_number(mean.mean)} ({_number(mean.low)} to {_number(mean.high)})"


def _number(value: float) -> str:
    if value == round(value):
        return f"{value:,.0f}"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
