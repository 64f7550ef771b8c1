"""Elementary functions of arrays, element by element, with the bits of `core.elementary`."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyrange.core import elementary
from skyrange.core.arrays import Floats
from skyrange.core.compiled import compiled

_SIN: Final = 0
_COS: Final = 1
_TAN: Final = 2
_ASIN: Final = 3
_EXP: Final = 4
_EXPM1: Final = 5
_LOG: Final = 6
_LOG10: Final = 7
_EXP10: Final = 8
_ATAN2: Final = 0
_HYPOT: Final = 1
_POWER: Final = 2


@compiled
def _fill_unary(which: int, values: Floats, out: Floats) -> None:
    for i in range(values.shape[0]):
        x = values[i]
        if which == _SIN:
            out[i] = elementary.sin(x)
        elif which == _COS:
            out[i] = elementary.cos(x)
        elif which == _TAN:
            out[i] = elementary.tan(x)
        elif which == _ASIN:
            out[i] = elementary.asin(x)
        elif which == _EXP:
            out[i] = elementary.exp(x)
        elif which == _EXPM1:
            out[i] = elementary.expm1(x)
        elif which == _LOG:
            out[i] = elementary.log(x)
        elif which == _LOG10:
            out[i] = elementary.log10(x)
        else:
            out[i] = elementary.exp10(x)


@compiled
def _fill_binary(which: int, first: Floats, second: Floats, out: Floats) -> None:
    for i in range(first.shape[0]):
        if which == _ATAN2:
            out[i] = elementary.atan2(first[i], second[i])
        elif which == _HYPOT:
            out[i] = elementary.hypot(first[i], second[i])
        else:
            out[i] = elementary.power(first[i], second[i])


def sin(angle: ArrayLike) -> Floats:
    """Sines of angles in radians, of any shape."""
    return _unary(_SIN, angle)


def cos(angle: ArrayLike) -> Floats:
    """Cosines of angles in radians, of any shape."""
    return _unary(_COS, angle)


def tan(angle: ArrayLike) -> Floats:
    """Tangents of angles in radians, of any shape."""
    return _unary(_TAN, angle)


def asin(sine: ArrayLike) -> Floats:
    """Arc sines in radians, of any shape; NaN outside -1 to 1."""
    return _unary(_ASIN, sine)


def exp(x: ArrayLike) -> Floats:
    """E to the power of numbers, of any shape."""
    return _unary(_EXP, x)


def expm1(x: ArrayLike) -> Floats:
    """E to the power of numbers, minus 1, of any shape."""
    return _unary(_EXPM1, x)


def exp10(x: ArrayLike) -> Floats:
    """10 to the power of numbers, of any shape."""
    return _unary(_EXP10, x)


def log(x: ArrayLike) -> Floats:
    """Natural logarithms, of any shape; minus infinity for 0, NaN below."""
    return _unary(_LOG, x)


def log10(x: ArrayLike) -> Floats:
    """Decimal logarithms, of any shape; minus infinity for 0, NaN below."""
    return _unary(_LOG10, x)


def atan2(y: ArrayLike, x: ArrayLike) -> Floats:
    """Angles of points from the x axis in radians; shapes as numpy broadcasts them."""
    return _binary(_ATAN2, y, x)


def hypot(x: ArrayLike, y: ArrayLike) -> Floats:
    """Lengths of vectors; shapes as numpy broadcasts them."""
    return _binary(_HYPOT, x, y)


def power(base: ArrayLike, exponent: ArrayLike) -> Floats:
    """Powers of numbers that are not negative; shapes as numpy broadcasts them."""
    return _binary(_POWER, base, exponent)


def length(vectors: NDArray[Any]) -> Floats:
    """The lengths of vectors along the last axis, whose squares are added in its order."""
    total = vectors[..., 0] * vectors[..., 0]
    for k in range(1, vectors.shape[-1]):
        total = total + vectors[..., k] * vectors[..., k]
    return np.asarray(np.sqrt(total), dtype=np.float64)


def _unary(which: int, values: ArrayLike) -> Floats:
    given = np.asarray(values, dtype=np.float64)
    out = np.empty(math.prod(given.shape))
    _fill_unary(which, np.ascontiguousarray(given).reshape(-1), out)
    return out.reshape(given.shape)[()]  # as numpy's functions, a number for a number


def _binary(which: int, first: ArrayLike, second: ArrayLike) -> Floats:
    one, other = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    shape = one.shape if one.shape == other.shape else np.broadcast_shapes(one.shape, other.shape)
    out = np.empty(math.prod(shape))
    _fill_binary(which, _spread(one, shape), _spread(other, shape), out)
    return out.reshape(shape)[()]


def _spread(values: Floats, shape: tuple[int, ...]) -> Floats:
    """The values in a row, repeated for a shape."""
    if values.shape != shape:
        values = np.array(np.broadcast_to(values, shape))
    return np.ascontiguousarray(values).reshape(-1)
