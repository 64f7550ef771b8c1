"""Size of a plan of runs: how many it has, and how many it may have."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from skyrange.core.errors import InputError

MAX_RUNS: Final = 1_000_000
"""Most runs of a plan that is not told otherwise."""


def check_size(who: str, sizes: Mapping[str, int], max_runs: int, remedy: str) -> None:
    """Raise `InputError` in the name of `who` for more runs than `max_runs`, before anything is made of any of them.

    `sizes` are the numbers whose product is that of the runs, each with what it counts; `remedy` allows more.
    """
    runs = math.prod(sizes.values())
    if runs > max_runs:
        value = f"{' × '.join(f'{number:,} {what}' for what, number in sizes.items())} = {runs:,} runs"
        raise InputError.one(who, "size", value, f"at most {max_runs:,} runs", remedy)
