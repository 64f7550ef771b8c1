"""Are elementary functions right to a few units in the last place, and the same compiled, in Python and in arrays?"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.core import elementary, elementary_python, elementwise, matrices
from tests.tiers import examples

ANGLES = st.one_of(
    st.floats(-8.0, 8.0), st.floats(-1.0e6, 1.0e6), st.integers(-636_000, 636_000).map(lambda k: k * math.pi / 2)
)
REAL = st.floats(allow_nan=False, allow_infinity=False, width=64)
SIZED = st.floats(1e-200, 1e200)
ANY = st.floats(allow_nan=True, allow_infinity=True)
CASES: dict[str, tuple[tuple[st.SearchStrategy[float], ...], Callable[..., Any], float]] = {
    "sin": ((ANGLES,), mpmath.sin, 1.0),
    "cos": ((ANGLES,), mpmath.cos, 1.0),
    "tan": ((ANGLES,), mpmath.tan, 2.5),
    "asin": ((st.floats(-1.0, 1.0),), mpmath.asin, 2.5),
    "acos": ((st.floats(-1.0, 1.0),), mpmath.acos, 2.5),
    "atan": ((REAL,), mpmath.atan, 1.5),
    "atan2": ((REAL.filter(bool), REAL.filter(bool)), mpmath.atan2, 2.0),
    "exp": ((st.floats(-708.0, 709.7),), mpmath.exp, 1.0),
    "expm1": ((st.floats(-40.0, 700.0) | st.floats(-0.5, 0.5),), mpmath.expm1, 4.0),
    "exp10": ((st.floats(-300.0, 308.0),), lambda x: mpmath.power(10, x), 2.0),
    "log": ((SIZED | st.floats(0.5, 2.0),), mpmath.log, 1.0),
    "log10": ((SIZED | st.floats(0.5, 2.0),), mpmath.log10, 2.0),
    "log1p": ((st.floats(-0.999999, 1e10) | st.floats(-0.5, 0.5),), mpmath.log1p, 2.0),
    "hypot": ((SIZED, SIZED), mpmath.hypot, 2.0),
    "hypot3": ((SIZED, SIZED, SIZED), lambda x, y, z: mpmath.sqrt(x * x + y * y + z * z), 2.5),
}
"""By function, its arguments, the reference, and the largest error in units in the last place."""
NAMES = (*CASES, "power", "erfc")


@pytest.mark.parametrize("name", CASES)
def test_the_error_is_a_few_units_in_the_last_place(name: str) -> None:
    arguments, reference, most_ulp = CASES[name]
    function = getattr(elementary, name)

    @settings(max_examples=examples(400))
    @given(st.tuples(*arguments))
    def check(given: tuple[float, ...]) -> None:
        with mpmath.workdps(60):
            exact = reference(*map(mpmath.mpf, given))
            if abs(exact) < 1e-290:
                return
            error = abs(mpmath.mpf(function(*given)) - exact) / math.ulp(float(exact))
        assert error <= most_ulp, (given, float(error))

    check()


@settings(max_examples=examples(200))
@given(st.floats(1e-3, 1e3), st.floats(-20.0, 20.0))
def test_a_power_loses_what_its_logarithm_has(base: float, exponent: float) -> None:
    with mpmath.workdps(60):
        exact = mpmath.power(mpmath.mpf(base), mpmath.mpf(exponent))
        error = abs(mpmath.mpf(elementary.power(base, exponent)) - exact) / exact
    assert error <= (3.0 + 2.0 * abs(exponent * math.log(base))) * 2.0**-53


@settings(max_examples=examples(200))
@given(st.floats(-26.0, 26.0))
def test_the_complementary_error_function(x: float) -> None:
    with mpmath.workdps(60):
        exact = mpmath.erfc(mpmath.mpf(x))
        assert abs(mpmath.mpf(elementary.erfc(x)) - exact) <= 2e-12 * exact


@pytest.mark.parametrize("name", NAMES)
def test_compiled_and_python_have_the_same_bits(name: str) -> None:
    function = getattr(elementary, name)
    count = {"atan2": 2, "hypot": 2, "power": 2, "hypot3": 3}.get(name, 1)

    @settings(max_examples=examples(200))
    @given(st.lists(ANY, min_size=count, max_size=count))
    def check(given: list[float]) -> None:
        compiled, python = function(*given), getattr(elementary_python, name)(*given)
        assert np.float64(compiled).tobytes() == np.float64(python).tobytes() or (
            compiled != compiled and python != python
        )

    check()


@settings(max_examples=examples(200))
@given(ANY, ANY)
def test_limits_are_those_of_c(y: float, x: float) -> None:
    assert math.isnan(elementary.atan2(y, x)) == math.isnan(np.arctan2(y, x))
    if not math.isnan(x) and not math.isnan(y):
        assert elementary.atan2(y, x) == pytest.approx(math.atan2(y, x), rel=1e-15)
        assert math.copysign(1.0, elementary.atan2(y, x)) == math.copysign(1.0, math.atan2(y, x))
    with np.errstate(all="ignore"):
        for name in ("exp", "log", "sin", "cos", "log1p", "expm1"):
            if name in ("sin", "cos") and abs(x) > 1e6 and math.isfinite(x):
                assert abs(getattr(elementary, name)(x)) <= 1.0
                continue
            own, theirs = getattr(elementary, name)(x), float(getattr(np, name)(np.float64(x)))
            assert own == pytest.approx(theirs, rel=1e-14, abs=1e-300, nan_ok=True), (name, x)


@settings(max_examples=examples(100))
@given(st.lists(st.tuples(st.floats(-700.0, 700.0), st.floats(-700.0, 700.0)), max_size=9))
def test_arrays_have_the_bits_of_their_elements(pairs: list[tuple[float, float]]) -> None:
    table = np.array(pairs).reshape(-1, 2)
    for name in ("sin", "cos", "tan", "exp", "expm1", "log", "log10", "exp10", "asin"):
        found = getattr(elementwise, name)(table)
        expected = [[getattr(elementary, name)(x) for x in row] for row in table.tolist()]
        assert np.array_equal(found, np.array(expected).reshape(-1, 2), equal_nan=True)
    for name in ("atan2", "hypot", "power"):
        found = getattr(elementwise, name)(table[:, 0], table[:, 1])
        expected = [getattr(elementary, name)(x, y) for x, y in table.tolist()]
        assert np.array_equal(found, np.array(expected).reshape(-1), equal_nan=True)
    assert elementwise.length(table).tolist() == [math.sqrt(x * x + y * y) for x, y in table.tolist()]


@pytest.mark.parametrize("name", NAMES)
def test_single_precision_and_whole_numbers_count_as_double(name: str) -> None:
    count = {"atan2": 2, "hypot": 2, "power": 2, "hypot3": 3}.get(name, 1)
    for kind in (np.float32, np.int64):
        given = [kind(value) for value in (0.7 if kind is np.float32 else 1, 3, 5)[:count]]
        found = getattr(elementary, name)(*given)
        assert found == getattr(elementary_python, name)(*map(float, given)), (kind, found)


def test_shapes_are_those_of_numpy() -> None:
    assert isinstance(elementwise.sin(0.5), float)
    assert elementwise.hypot(np.ones((2, 1)), np.ones(3)).shape == (2, 3)
    assert elementwise.atan2(1.0, np.ones((2, 0))).shape == (2, 0)
    assert elementwise.cos(np.ones((4, 6))[::2, ::3].T).shape == (2, 2)


@settings(max_examples=examples(100))
@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_matrices_are_those_of_numpy(size: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    a, b = random.normal(size=(2, size, size))
    vector = random.normal(size=size)
    assert np.allclose(matrices.multiply(a, b, vector), a @ b @ vector)
    assert np.allclose(matrices.multiply(vector, a), vector @ a)
    stack = random.normal(size=(3, size, size))
    assert np.allclose(matrices.multiply(stack, a), stack @ a)
    assert math.isclose(matrices.dot(vector, vector), float(vector @ vector))
    positive = a @ a.T + np.eye(size)
    assert np.allclose(matrices.multiply(positive, matrices.invert(positive)), np.eye(size))
    assert np.allclose(matrices.solve(positive, vector), np.linalg.solve(positive, vector))
    lower = matrices.factor(positive)
    assert np.allclose(lower, np.linalg.cholesky(positive))
    assert np.isnan(matrices.factor(-positive)).any()
    assert matrices.multiply(np.ones((size, 0)), np.ones((0, size))).tolist() == np.zeros((size, size)).tolist()
    assert matrices.multiply(np.ones((0, size)), vector).shape == (0,)


def test_matrices_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="have no product"):
        matrices.multiply(np.ones((2, 3)), np.ones((2, 3)))
