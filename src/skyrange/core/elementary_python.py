"""Elementary functions with the same bits on every machine: made of IEEE 754 operations in a fixed order, in Python.

C libraries and numpy round sine, exponential, power and the like differently, and numpy chooses its code by processor.
These functions use addition, multiplication, division, square roots and exact operations alone, which IEEE 754 defines
to the bit. Whatever `frames` and `truth` depend on calls them instead of those of `math` and numpy, here or compiled
(`core.elementary`); `tests/unit/test_elementary_use.py` holds this.

Polynomials are Taylor series. Their coefficients are ratios of whole numbers. In the reduced range their remainder is
below 2^-53 of the result for the sine, and below 2^-57 for all others. `tests/unit/test_elementary.py` compares the
functions with a reference of 60 digits.

The reductions are those of W. J. Cody & W. Waite, Software Manual for the Elementary Functions (1980): constants in
parts, whose products with small whole numbers are exact. These constants are written in hexadecimal.

A call takes three times as long as one of a compiled function, which has to be loaded or compiled first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Final, TypeVar

T = TypeVar("T", bound=Any)

_HALF_PI_1: Final = float.fromhex("0x1.921fb54400000p+0")  # the first 33 bits of π/2, the next 33, and the rest
_HALF_PI_2: Final = float.fromhex("0x1.0b4611a600000p-34")
_HALF_PI_3: Final = float.fromhex("0x1.3198a2e037073p-69")
_HALF_PI: Final = float.fromhex("0x1.921fb54442d18p+0")
_HALF_PI_REST: Final = float.fromhex("0x1.1a62633145c07p-54")
_PI: Final = float.fromhex("0x1.921fb54442d18p+1")
_PI_REST: Final = float.fromhex("0x1.1a62633145c07p-53")
_TWO_OVER_PI: Final = float.fromhex("0x1.45f306dc9c883p-1")
_MAX_ANGLE: Final = 1.0e6
"""Angles beyond are first reduced by the number nearest to 2π, exactly: the result is that of another angle."""
_LN2_1: Final = float.fromhex("0x1.62e42fefa2000p-1")  # the first 40 bits of ln 2, and the rest
_LN2_2: Final = float.fromhex("0x1.9ef35793c7673p-41")
_LOG2_E: Final = float.fromhex("0x1.71547652b82fep+0")
_LOG10_E: Final = float.fromhex("0x1.bcb7b1526e50ep-2")
_LN_10: Final = float.fromhex("0x1.26bb1bbb55516p+1")
_SPLIT: Final = 134217729.0  # 2^27 + 1
_LN_10_HIGH: Final = _SPLIT * _LN_10 - (_SPLIT * _LN_10 - _LN_10)
_LN_10_LOW: Final = _LN_10 - _LN_10_HIGH
_LN_10_REST: Final = -float.fromhex("0x1.f48ad494ea3e9p-53")
_ROOT_HALF: Final = 0.7071067811865476
_MAX_EXP: Final = 709.782712893384  # beyond, the result is infinite
_MIN_EXP: Final = -745.1332191019412  # below, it is zero
_TAN_1: Final = float.fromhex("0x1.975f5e0553158p-3")  # tan(kπ/16), and its arc tangent in two parts
_TAN_2: Final = float.fromhex("0x1.a827999fcef32p-2")
_TAN_3: Final = float.fromhex("0x1.561b82ab7f990p-1")
_ATAN_1, _ATAN_1_REST = float.fromhex("0x1.921fb54442d18p-3"), float.fromhex("0x1.f93470dfef04ap-58")
_ATAN_2, _ATAN_2_REST = float.fromhex("0x1.921fb54442d18p-2"), float.fromhex("0x1.c398861b78b55p-59")
_ATAN_3, _ATAN_3_REST = float.fromhex("0x1.2d97c7f3321d2p-1"), -float.fromhex("0x1.8f57cafebcf16p-58")
_ATAN_4, _ATAN_4_REST = float.fromhex("0x1.921fb54442d18p-1"), float.fromhex("0x1.1a62633145c07p-55")
_BOUND_0: Final = 0.0984914033571642  # tan of odd multiples of π/32: where the nearest multiple of π/16 changes
_BOUND_1: Final = 0.303346683607342
_BOUND_2: Final = 0.534511135950792
_BOUND_3: Final = 0.82067879082866
_LARGE: Final = 1.0e150
_SMALL: Final = 1.0e-140


def shifted_sine(angle: float, quarters: int) -> float:
    """Sine of an angle in radians plus so many right angles; NaN for one that is not finite."""
    x = angle
    if not abs(x) <= _MAX_ANGLE:
        if x - x != 0.0:
            return math.nan
        x = x % (2.0 * _PI)
    turns = math.floor(x * _TWO_OVER_PI + 0.5)
    k = float(turns)
    first = x - k * _HALF_PI_1
    second = k * _HALF_PI_2
    near = first - second
    rest = k * _HALF_PI_3 - ((first - near) - second)
    r = near - rest
    tail = (near - r) - rest
    z = r * r
    quadrant = (turns + quarters) & 3
    if quadrant & 1:
        c = z * (1.0 / 24.0 + z * (-1.0 / 720.0 + z * (1.0 / 40320.0 + z * (-1.0 / 3628800.0 + z * (
            1.0 / 479001600.0 + z * (-1.0 / 87178291200.0 + z * (1.0 / 20922789888000.0)))))))  # fmt: skip
        half = 0.5 * z
        most = 1.0 - half
        value = most + (((1.0 - most) - half) + (z * c - r * tail))
    else:
        s = -1.0 / 6.0 + z * (1.0 / 120.0 + z * (-1.0 / 5040.0 + z * (1.0 / 362880.0 + z * (-1.0 / 39916800.0 + z * (
            1.0 / 6227020800.0 + z * (-1.0 / 1307674368000.0))))))  # fmt: skip
        value = r + (r * z * s + tail * (1.0 - 0.5 * z))
    return -value if quadrant & 2 else value


def sin(angle: float) -> float:
    """Sine of an angle in radians; NaN for one that is not finite."""
    return shifted_sine(angle, 0)


def cos(angle: float) -> float:
    """Cosine of an angle in radians; NaN for one that is not finite."""
    return shifted_sine(angle, 1)


def tan(angle: float) -> float:
    """Tangent of an angle in radians; NaN for one that is not finite."""
    return sin(angle) / cos(angle)


def atan(ratio: float) -> float:
    """Arc tangent in radians."""
    a = abs(ratio)
    inverse = a > 1.0
    t = 1.0 / a if inverse else a
    if t < _BOUND_0:
        c, base, base_rest = 0.0, 0.0, 0.0
    elif t < _BOUND_1:
        c, base, base_rest = _TAN_1, _ATAN_1, _ATAN_1_REST
    elif t < _BOUND_2:
        c, base, base_rest = _TAN_2, _ATAN_2, _ATAN_2_REST
    elif t < _BOUND_3:
        c, base, base_rest = _TAN_3, _ATAN_3, _ATAN_3_REST
    else:
        c, base, base_rest = 1.0, _ATAN_4, _ATAN_4_REST
    u = (t - c) / (1.0 + t * c)
    z = u * u
    p = -1.0 / 3.0 + z * (1.0 / 5.0 + z * (-1.0 / 7.0 + z * (1.0 / 9.0 + z * (-1.0 / 11.0 + z * (
        1.0 / 13.0 + z * (-1.0 / 15.0 + z * (1.0 / 17.0)))))))  # fmt: skip
    value = base + (u + (u * z * p + base_rest))
    if inverse:
        value = _HALF_PI - (value - _HALF_PI_REST)
    return math.copysign(value, ratio)


def atan2(y: float, x: float) -> float:
    """The angle of the point (x, y) from the x axis, in radians, with the signs and limits of C's atan2."""
    if x != x or y != y:
        return math.nan
    across, along = abs(y * 1.0), abs(x * 1.0)  # of double precision, where a compiled function has another
    if across == 0.0 and along == 0.0:
        angle = 0.0
    elif across == math.inf and along == math.inf:
        angle = _ATAN_4
    elif across > along:
        t = along / across
        angle = _HALF_PI - (atan(t) - _HALF_PI_REST)
    else:
        angle = atan(across / along)
    if math.copysign(1.0, x) < 0.0:
        angle = _PI - (angle - _PI_REST)
    return math.copysign(angle, y)


def asin(sine: float) -> float:
    """Arc sine in radians; NaN outside -1 to 1."""
    if not abs(sine) <= 1.0:
        return math.nan
    return atan2(sine, math.sqrt((1.0 - sine) * (1.0 + sine)))


def acos(cosine: float) -> float:
    """Arc cosine in radians; NaN outside -1 to 1."""
    if not abs(cosine) <= 1.0:
        return math.nan
    return atan2(math.sqrt((1.0 - cosine) * (1.0 + cosine)), cosine)


def exp(x: float) -> float:
    """E to the power of x."""
    if x != x:
        return x
    if x > _MAX_EXP:
        return math.inf
    if x < _MIN_EXP:
        return 0.0
    k = math.floor(x * _LOG2_E + 0.5)
    high = x - float(k) * _LN2_1
    low = float(k) * _LN2_2
    r = high - low
    tail = (high - r) - low
    p = 1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r * (1.0 / 5040.0 + r * (
        1.0 / 40320.0 + r * (1.0 / 362880.0 + r * (1.0 / 3628800.0 + r * (1.0 / 39916800.0 + r * (
        1.0 / 479001600.0 + r * (1.0 / 6227020800.0))))))))))  # fmt: skip
    value = 1.0 + (r + (tail + r * r * (0.5 + r * p)))
    return math.ldexp(value, k)


def expm1(x: float) -> float:
    """E to the power of x, minus 1, exact where x is small."""
    x = x * 1.0  # of double precision, where a compiled function has another
    if not abs(x) <= 0.35:
        return exp(x) - 1.0
    p = 1.0 / 6.0 + x * (1.0 / 24.0 + x * (1.0 / 120.0 + x * (1.0 / 720.0 + x * (1.0 / 5040.0 + x * (
        1.0 / 40320.0 + x * (1.0 / 362880.0 + x * (1.0 / 3628800.0 + x * (1.0 / 39916800.0 + x * (
        1.0 / 479001600.0 + x * (1.0 / 6227020800.0 + x * (1.0 / 87178291200.0)))))))))))  # fmt: skip
    return x + x * x * (0.5 + x * p)


def exp10(x: float) -> float:
    """10 to the power of x."""
    if not abs(x) < 400.0:
        return exp(x * _LN_10)
    y = x * _LN_10
    c = _SPLIT * x  # the rounding error of the product, by the splitting of Dekker (1971)
    high = c - (c - x)
    low = x - high
    rest = low * _LN_10_LOW - (((y - high * _LN_10_HIGH) - low * _LN_10_HIGH) - high * _LN_10_LOW)
    value = exp(y)
    return value + value * (rest + x * _LN_10_REST) if value < math.inf else value


def log(x: float) -> float:
    """Natural logarithm; minus infinity for 0, NaN below."""
    if x != x or x == math.inf:
        return x
    if x <= 0.0:
        return -math.inf if x == 0.0 else math.nan
    m, k = math.frexp(x)
    if m < _ROOT_HALF:
        m *= 2.0
        k -= 1
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    p = z * (2.0 / 3.0 + z * (2.0 / 5.0 + z * (2.0 / 7.0 + z * (2.0 / 9.0 + z * (2.0 / 11.0 + z * (2.0 / 13.0 + z * (
        2.0 / 15.0 + z * (2.0 / 17.0 + z * (2.0 / 19.0 + z * (2.0 / 21.0 + z * (2.0 / 23.0)))))))))))  # fmt: skip
    half = 0.5 * f * f
    return float(k) * _LN2_1 - ((half - (s * (half + p) + float(k) * _LN2_2)) - f)


def log1p(x: float) -> float:
    """Natural logarithm of 1 + x, exact where x is small; minus infinity for -1, NaN below."""
    if not -0.29 <= x <= 0.41:
        if x != x or x == math.inf or x <= -1.0:
            return log(1.0 + x)
        whole = 1.0 + x
        return log(whole) + (x - (whole - 1.0)) / whole
    s = x / (2.0 + x)
    z = s * s
    p = z * (2.0 / 3.0 + z * (2.0 / 5.0 + z * (2.0 / 7.0 + z * (2.0 / 9.0 + z * (2.0 / 11.0 + z * (2.0 / 13.0 + z * (
        2.0 / 15.0 + z * (2.0 / 17.0 + z * (2.0 / 19.0 + z * (2.0 / 21.0 + z * (2.0 / 23.0)))))))))))  # fmt: skip
    half = 0.5 * x * x
    return x - (half - s * (half + p))


def log10(x: float) -> float:
    """Decimal logarithm; minus infinity for 0, NaN below."""
    return log(x) * _LOG10_E


def power(base: float, exponent: float) -> float:
    """`base` to the power of `exponent`, as exp(exponent · log(base)); NaN for a negative base."""
    if exponent == 0.0:
        return 1.0
    if base == 0.0:
        return 0.0 if exponent > 0.0 else math.inf
    return exp(exponent * log(base))


def hypot(x: float, y: float) -> float:
    """The length of the vector (x, y)."""
    a, b = abs(x * 1.0), abs(y * 1.0)  # of double precision, where a compiled function has another
    most = max(a, b)
    if a == math.inf or b == math.inf:
        return math.inf
    if _SMALL < most < _LARGE or most == 0.0 or a != a or b != b:
        return math.sqrt(a * a + b * b)
    a /= most
    b /= most
    return most * math.sqrt(a * a + b * b)


def hypot3(x: float, y: float, z: float) -> float:
    """The length of the vector (x, y, z)."""
    a, b, c = abs(x * 1.0), abs(y * 1.0), abs(z * 1.0)  # of double precision, where a compiled function has another
    most = max(a, b, c)
    if a == math.inf or b == math.inf or c == math.inf:
        return math.inf
    if _SMALL < most < _LARGE or most == 0.0 or a != a or b != b or c != c:
        return math.sqrt(a * a + b * b + c * c)
    a /= most
    b /= most
    c /= most
    return most * math.sqrt(a * a + b * b + c * c)


def erfc(x: float) -> float:
    """Complementary error function.

    Below 2.5 by the series of Abramowitz & Stegun 7.1.6, above by their continued fraction 7.1.14. The relative error
    is below 1e-12, that of the difference from 1 at 2.5.
    """
    if x != x:
        return x
    a = abs(x * 1.0)  # of double precision, where a compiled function has another
    square = a * a
    if a > 27.3:
        value = 0.0
    elif a < 2.5:
        term = a
        total = a
        for n in range(1, 60):
            term *= 2.0 * square / (2.0 * n + 1.0)
            total += term
        value = 1.0 - 2.0 / math.sqrt(_PI) * exp(-square) * total
    else:
        fraction = a
        for n in range(80, 0, -1):
            fraction = a + 0.5 * n / fraction
        value = exp(-square) / (math.sqrt(_PI) * fraction)
    return 2.0 - value if x < 0.0 else value


def square(x: T) -> T:
    """X times x, in Python: `x ** 2` is a power, which C libraries round as they please."""
    product: T = x * x
    return product


def add_up(numbers: Iterable[float]) -> float:
    """The sum of numbers, in their order: Python's `sum` makes up for rounding from 3.12 on, and not before."""
    total = 0.0
    for number in numbers:
        total += number
    return total


def distance(a: Sequence[float], b: Sequence[float]) -> float:
    """The distance of two points, in Python; the squares are added in order."""
    total = 0.0
    for first, second in zip(a, b, strict=True):
        total += (first - second) * (first - second)
    return math.sqrt(total)
