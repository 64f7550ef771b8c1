"""Paired check of an audit: whether the arms of a block differ where they must be equal, and by which columns.

Up to the onset all arms of a block are one flight, and up to the first answer a sham has the shape of its attack. Of
runs that repeat to the byte every difference is a leak, be it in one block: a classifier of few blocks misses it. Of
other runs arms differ by chance, so a column leaks if the attacked arm is above the others, or below, in more blocks
than chance explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.statistics.share_tests import LEVEL, adjust_by_holm, sign_test

Floats = NDArray[np.float64]
ROWS: Final = "number of rows"
"""The name by which arms with different numbers of rows are told."""


def count_differences(
    columns: Sequence[str], values: Floats, attacked: NDArray[np.bool_], blocks: Sequence[str], runs: Sequence[str]
) -> dict[str, int]:
    """By column, the number of blocks in which an attacked run differs from another one of the block, the most first.

    `values` (n, k) are those of the rows, not-a-number where there is none; rows of a run are in the order in which
    they are compared. Columns that never differ are not among them.
    """
    found: dict[str, int] = {}
    for rows in _by_name(blocks).values():
        own = _by_name([runs[row] for row in rows])
        parts = {run: np.array(rows)[places] for run, places in own.items()}
        hostile = [part for part in parts.values() if attacked[part[0]]]
        others = [part for part in parts.values() if not attacked[part[0]]]
        differing: set[str] = set()
        for one in hostile:
            for other in others:
                if len(one) != len(other):
                    differing.add(ROWS)
                    continue
                mine, theirs = values[one], values[other]
                unequal = ((mine != theirs) & ~(np.isnan(mine) & np.isnan(theirs))).any(axis=0)
                differing |= {columns[place] for place in np.flatnonzero(unequal).tolist()}
        for name in differing:
            found[name] = found.get(name, 0) + 1
    return dict(sorted(found.items(), key=lambda one: (-one[1], one[0])))


def find_shifted_columns(
    columns: Sequence[str], values: Floats, attacked: NDArray[np.bool_], blocks: Sequence[str]
) -> list[str]:
    """The columns whose mean over the attacked rows of a block is above that of the others, or below, in too many
    blocks for chance: by sign tests, adjusted for the number of columns.
    """
    signs = []
    for rows in _by_name(blocks).values():
        own = np.array(rows)
        mine, theirs = values[own[attacked[own]]], values[own[~attacked[own]]]
        if len(mine) and len(theirs):
            signs.append(np.sign(_means(mine) - _means(theirs)))
    if not signs:
        return []
    above, below = ((np.array(signs) * way > 0).sum(axis=0) for way in (1, -1))
    p_values = [
        min(1.0, 2.0 * sign_test(int(max(up, down)), int(up + down))) if up + down else 1.0
        for up, down in zip(above.tolist(), below.tolist(), strict=True)
    ]
    adjusted = adjust_by_holm(p_values)
    return [name for p, name in sorted(zip(adjusted, columns, strict=True)) if p <= LEVEL]


def _means(values: Floats) -> Floats:
    """(k,) the means of (n, k) values without those that are not numbers; 0 without any."""
    known = ~np.isnan(values)
    means: Floats = np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return means


def _by_name(names: Sequence[str]) -> Mapping[str, list[int]]:
    found: dict[str, list[int]] = {}
    for place, name in enumerate(names):
        found.setdefault(name, []).append(place)
    return found
