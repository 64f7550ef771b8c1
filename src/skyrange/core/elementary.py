"""Elementary functions with the same bits on every machine, compiled by numba.

They are those of `core.elementary_python`, which says what they do, to the same bits: numba may neither contract nor
reorder operations (`core.compiled`). `core.elementwise` has them for arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import Any, ParamSpec, TypeVar

from skyrange.core import elementary_python
from skyrange.core.compiled import compiled

P = ParamSpec("P")
R = TypeVar("R")

_globals: dict[str, Any] = {**vars(elementary_python), "__name__": __name__}
"""What the functions read when compiled: constants, and each other's compiled versions."""


def _compile(function: Callable[P, R]) -> Callable[P, R]:
    compilable = compiled(FunctionType(function.__code__, _globals, function.__name__))
    _globals[function.__name__] = compilable
    return compilable


shifted_sine = _compile(elementary_python.shifted_sine)
sin = _compile(elementary_python.sin)
cos = _compile(elementary_python.cos)
tan = _compile(elementary_python.tan)
atan = _compile(elementary_python.atan)
atan2 = _compile(elementary_python.atan2)
asin = _compile(elementary_python.asin)
acos = _compile(elementary_python.acos)
exp = _compile(elementary_python.exp)
expm1 = _compile(elementary_python.expm1)
exp10 = _compile(elementary_python.exp10)
log = _compile(elementary_python.log)
log1p = _compile(elementary_python.log1p)
log10 = _compile(elementary_python.log10)
power = _compile(elementary_python.power)
hypot = _compile(elementary_python.hypot)
hypot3 = _compile(elementary_python.hypot3)
erfc = _compile(elementary_python.erfc)
