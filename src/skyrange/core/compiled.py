"""How is a numeric kernel compiled? One way for all: cached, IEEE-exact, single-threaded.

No fastmath and no parallel reductions, because a run's bytes must not depend on the machine's mood.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` with numba when first called; keeps its Python type for checkers."""
    return cast("Callable[P, R]", numba.njit(cache=True, fastmath=False)(function))
