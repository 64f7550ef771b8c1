"""Responses to a factor: means of a quantity at its levels, over all blocks that have that level."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from skyrange.statistics.means import Interval, estimate_mean
from skyrange.study.sweep.design.blocks import Block, is_numeric

MAX_LEVELS: Final = 8
"""More different values than these are put together into that many levels of equal size."""


class Level(NamedTuple):
    """Some values of a factor that count as one."""

    label: str
    at: float
    """Where it is on an axis: its mean, or its number where values are no numbers."""
    blocks: tuple[str, ...]


class Curve(NamedTuple):
    """The response of one arm."""

    name: str
    colour: int
    """Its number in the palette."""
    points: tuple[tuple[float, Interval], ...]
    """At each level that has samples: where it is, and the mean."""


def find_levels(blocks: Sequence[Block], factor: str, most: int = MAX_LEVELS) -> list[Level]:
    """The levels of a factor, in order."""
    values = [block.values[factor] for block in blocks]
    if is_numeric(blocks, factor):
        ordered = sorted(blocks, key=lambda block: (block.values[factor], block.name))
        different = sorted(set(values))
        if len(different) <= most:
            return [
                Level(f"{value:.4g}", float(value), _names(block for block in ordered if block.values[factor] == value))
                for value in different
            ]
        groups = [ordered[k * len(ordered) // most : (k + 1) * len(ordered) // most] for k in range(most)]
        return [_group(group, factor) for group in groups if group]
    kinds = list(dict.fromkeys(map(str, values)))
    return [
        Level(kind, float(number), _names(block for block in blocks if str(block.values[factor]) == kind))
        for number, kind in enumerate(kinds)
    ]


def trace_response(
    name: str, colour: int, levels: Sequence[Level], samples: Mapping[str, float], clusters: Mapping[str, str],
    within: frozenset[str] | None = None,
) -> Curve:  # fmt: skip
    """The response of `samples`, by block, at each level; with `within`, of these blocks alone."""
    points = []
    for level in levels:
        chosen = [one for one in level.blocks if one in samples and (within is None or one in within)]
        mean = estimate_mean([samples[one] for one in chosen], [clusters[one] for one in chosen])
        if mean is not None:
            points.append((level.at, mean))
    return Curve(name, colour, tuple(points))


def _group(blocks: Sequence[Block], factor: str) -> Level:
    values = [float(block.values[factor]) for block in blocks]
    return Level(f"{min(values):.3g} to {max(values):.3g}", sum(values) / len(values), _names(blocks))


def _names(blocks: Iterable[Block]) -> tuple[str, ...]:
    return tuple(block.name for block in blocks)
