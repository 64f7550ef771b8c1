"""Functions of one key compute the same, whatever they are; layout, comments and docstrings have no part in it."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numba.core.dispatcher import Dispatcher

from skyrange.core.compiled import compute_key

ARGUMENTS = ((0.25, 3), (-2.0, 7), (5, -1.5))

NUMBERS = st.sampled_from(["0", "1", "2", "0.0", "-0.0", "1.0", "True", "3.5"])
LEAVES = st.one_of(st.sampled_from(["x", "y", "A", "B", "TABLE[0]"]), NUMBERS)
EXPRESSIONS = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.builds("({} {} {})".format, inner, st.sampled_from(["+", "-", "*"]), inner),
        st.builds("({} if {} < {} else {})".format, inner, inner, inner, inner),
        st.builds("{}({}, {})".format, st.sampled_from(["min", "max", "callee"]), inner, inner),
    ),
    max_leaves=6,
)
PROGRAMS = st.fixed_dictionaries(
    {
        "caller": EXPRESSIONS,
        "callee": EXPRESSIONS.filter(lambda text: "callee" not in text),
        "A": NUMBERS,
        "B": NUMBERS,
        "TABLE": st.sampled_from(["np.array([1.0])", "np.array([1])", "np.array([2.0, 1.0])", "(1.0, 2)"]),
        "default": NUMBERS,
    }
)
NOISE = st.fixed_dictionaries(
    {
        "before": st.sampled_from(["", "\n\n", "# a comment\n", "UNUSED = 5\n"]),
        "docstring": st.sampled_from(["", "    'What it returns.'\n", "    'Another text.'\n"]),
        "inside": st.sampled_from(["", "\n", "    # a comment\n"]),
    }
)
QUIET = {"before": "", "docstring": "", "inside": ""}


def caller(program: dict[str, str], noise: dict[str, str]) -> Dispatcher:
    text = f"""
import numpy as np
from skyrange.core.compiled import compiled
A, B, TABLE = {program["A"]}, {program["B"]}, {program["TABLE"]}
{noise["before"]}
@compiled
def callee(x, y={program["default"]}):
{noise["inside"]}    return {program["callee"]}
@compiled
def caller(x, y):
{noise["docstring"]}{noise["inside"]}    return {program["caller"]}
"""
    names: dict[str, Any] = {"__name__": "program"}
    exec(text, names)
    found = names["caller"]
    assert isinstance(found, Dispatcher)
    return found


def results(function: Dispatcher) -> list[tuple[str, str]]:
    """What Python makes of it, types and signs of zero included: nothing has to be compiled for it."""
    function.py_func.__globals__["callee"] = function.py_func.__globals__["callee"].py_func
    values = [function.py_func(*one) for one in ARGUMENTS]
    return [(type(np.asarray(one)[()]).__name__, repr(float(one))) for one in values]


@given(program=PROGRAMS, noise=NOISE)
def test_layout_has_no_part_in_a_key(program: dict[str, str], noise: dict[str, str]) -> None:
    assert compute_key(caller(program, noise)) == compute_key(caller(program, QUIET))


@given(program=PROGRAMS, part=st.sampled_from(["caller", "callee", "A", "B", "TABLE", "default"]), data=st.data())
def test_functions_of_one_key_compute_the_same(program: dict[str, str], part: str, data: st.DataObject) -> None:
    other = program | {part: data.draw(PROGRAMS.map(lambda one: one[part]))}
    one, another = caller(program, QUIET), caller(other, QUIET)
    keys = compute_key(one), compute_key(another)
    if results(one) != results(another):
        assert keys[0] != keys[1]
