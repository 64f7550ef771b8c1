"""Does the key of a compiled function change when what numba compiles of it changes, and only then?"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from types import ModuleType
from typing import Any

import pytest
from numba.core.dispatcher import Dispatcher

import skyrange
from skyrange.core.compiled import compute_key

SHAPES = '''
from typing import NamedTuple
import numpy as np
from skyrange.core.compiled import compiled, inlined

TABLE = np.array([1.0, 2.0])
PAIR = (1, 2.0)

class Point(NamedTuple):
    x: float
    y: float = 0.0

@inlined
def area(x, scale=2.0):
    """The area."""
    return x * scale + TABLE[0]

@compiled
def alone(x):
    return x + PAIR[0]

@compiled
def point(x):
    return Point(x)
'''
FLIGHTS = """
import shapes
from shapes import area
from skyrange import made
from skyrange.core.compiled import compiled
LIMIT = 3

@compiled
def total(x):
    return area(x) + 1

@compiled
def bounded(x):
    return min(x, LIMIT)

@compiled
def whole(x):
    return total(x) + bounded(x)

@compiled
def by_attribute(x):
    return made.FACTOR * x

@compiled
def even(n):
    return True if n == 0 else odd(n - 1)

@compiled
def odd(n):
    return False if n == 0 else even(n - 1)
"""
MADE = "FACTOR = 2.0\nOTHER = 1.0\n"


def keys(monkeypatch: pytest.MonkeyPatch, **edits: tuple[str, str]) -> dict[str, str]:
    """The keys of all functions of three modules, in each of which one text may be replaced."""
    texts = {"skyrange.made": MADE, "shapes": SHAPES, "flights": FLIGHTS}
    found: dict[str, str] = {}
    with monkeypatch.context() as patch:
        for name, text in texts.items():
            old, new = edits.get(name.rpartition(".")[2], ("", ""))
            assert old in text
            module = ModuleType(name)
            patch.setitem(sys.modules, name, module)
            if name == "skyrange.made":
                patch.setattr(skyrange, "made", module, raising=False)
            exec(compile(text.replace(old, new) if old else text, f"{name}.py", "exec"), vars(module))
            own = [one for one in vars(module).values() if isinstance(one, Dispatcher)]
            found |= {one.py_func.__name__: compute_key(one) for one in own}
    return found


@pytest.mark.parametrize(
    ("module", "old", "new", "concerned"),
    [
        ("shapes", "return x + PAIR[0]", "return x - PAIR[0]", {"alone"}),
        ("shapes", "PAIR = (1, 2.0)", "PAIR = (1.0, 2.0)", {"alone"}),
        ("shapes", "y: float = 0.0", "y: float = 1.0", {"point"}),
        ("shapes", "y: float = 0.0", "z: float = 0.0", {"point"}),
        ("shapes", "scale=2.0", "scale=2.5", {"area", "total", "whole"}),
        ("shapes", "scale=2.0", "scale=2", {"area", "total", "whole"}),
        ("shapes", "* scale", "/ scale", {"area", "total", "whole"}),
        ("shapes", "@inlined", "@compiled", {"area", "total", "whole"}),
        ("shapes", "[1.0, 2.0]", "[1.0, 3.0]", {"area", "total", "whole"}),
        ("shapes", "[1.0, 2.0]", "[1.0, 2.0], dtype=np.float32", {"area", "total", "whole"}),
        ("shapes", "[1.0, 2.0]", "[1.0], dtype=[('a', float)]", {"area", "total", "whole"}),
        ("shapes", "np.array([1.0, 2.0])", "np.float64(1.0)", {"area", "total", "whole"}),
        ("flights", "LIMIT = 3", "LIMIT = 4", {"bounded", "whole"}),
        ("flights", "LIMIT = 3", "LIMIT = True", {"bounded", "whole"}),
        ("flights", "min(x", "max(x", {"bounded", "whole"}),
        ("flights", "+ 1", "+ 1.0", {"total", "whole"}),
        ("flights", "True if", "1 if", {"even", "odd"}),
        ("made", "FACTOR = 2.0", "FACTOR = 3.0", {"by_attribute"}),
    ],
)
def test_a_change_changes_the_keys_of_those_concerned(
    monkeypatch: pytest.MonkeyPatch, module: str, old: str, new: str, concerned: set[str]
) -> None:
    before, after = keys(monkeypatch), keys(monkeypatch, **{module: (old, new)})
    assert {name for name in before if before[name] != after[name]} == concerned


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [
        ("shapes", '"""The area."""', '"""Another text."""'),
        ("shapes", '"""The area."""', '"""The area."""  # of a square'),
        ("shapes", "@inlined", "\n\n@inlined"),
        ("shapes", "return x + PAIR[0]", "\n    return x + (\n        PAIR[0]\n    )"),
        ("flights", "LIMIT = 3", "LIMIT = 3\nANOTHER = 4"),
        ("made", "OTHER = 1.0", "OTHER = 2.0"),
    ],
)
def test_what_is_not_compiled_is_no_part_of_a_key(
    monkeypatch: pytest.MonkeyPatch, module: str, old: str, new: str
) -> None:
    assert keys(monkeypatch) == keys(monkeypatch, **{module: (old, new)})


def test_functions_have_keys_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    found = keys(monkeypatch)
    assert len(set(found.values())) == len(found) == 9


def function(text: str, **values: Any) -> Dispatcher:
    names: dict[str, Any] = {"__name__": "flights", **values}
    exec("from skyrange.core.compiled import compiled\n@compiled\n" + text, names)
    found = names["step"]
    assert isinstance(found, Dispatcher)
    return found


def test_a_key_is_not_that_of_interpreted_code_which_python_has_adapted() -> None:
    step = function("def step(x):\n    return x * 2.0")
    before = compute_key(step)
    for _ in range(1000):
        step.py_func(1.0)
    assert compute_key(step, anew=True) == before


def test_a_docstring_that_is_loaded_is_a_constant() -> None:
    once, twice = (function(f"def step():\n    '{word}'\n    return '{word}'") for word in ("a", "b"))
    assert compute_key(once) != compute_key(twice)


def test_a_name_beyond_the_first_256_is_read() -> None:
    many = " + ".join(f"x{i}" for i in range(300))
    values = {f"x{i}": i for i in range(300)}
    one, other = (function(f"def step():\n    return {many}", **values | {"x299": last}) for last in (299, 0))
    assert compute_key(one) != compute_key(other)


def test_values_of_a_closure_count() -> None:
    text = "def step(x):\n    return x + limit"
    factory = "def make(limit):\n" + "".join(f"    {line}\n" for line in ["@compiled", *text.splitlines()])
    names: dict[str, Any] = {"__name__": "flights"}
    exec("from skyrange.core.compiled import compiled\n" + factory + "    return step\n", names)
    one, same, other = (compute_key(names["make"](limit)) for limit in (1, 1, 2))
    assert one == same != other


def test_a_value_that_has_changed_is_seen_anew() -> None:
    step = function("def step(x):\n    return x + LIMIT", LIMIT=1)
    before = compute_key(step)
    step.py_func.__globals__["LIMIT"] = 2
    assert compute_key(step) == before
    assert compute_key(step, anew=True) != before


@pytest.mark.parametrize(
    ("text", "other"),
    [("x[:6]", "x[:7]"), ("x[1:]", "x[:1]"), ("x[::2]", "x[::3]"), ("x in {1, 2}", "x in {1, 3}")],
)
def test_slices_and_sets_of_constants_count(text: str, other: str) -> None:
    one, same, changed = (compute_key(function(f"def step(x):\n    return {text}")) for text in (text, text, other))
    assert one == same != changed


def test_a_slice_that_is_a_value_has_a_digest() -> None:
    """From Python 3.14 on, slices are constants."""
    one, same, other = (
        compute_key(function("def step(x):\n    return x[PART]", PART=part))
        for part in (slice(None, 6), slice(None, 6), slice(6))
    )
    assert one == same == other
    assert compute_key(function("def step(x):\n    return x[PART]", PART=slice(None, 6, 2))) != one


def test_a_value_without_digest_is_named() -> None:
    step = function("def step(x):\n    return x + LIMIT[0]", LIMIT=[1])
    with pytest.raises(TypeError, match=r"compiled function flights\.step: global LIMIT: \[1\] of type list has no"):
        compute_key(step)


def test_every_compiled_function_has_a_key() -> None:
    found: set[Dispatcher] = set()
    for module in pkgutil.walk_packages(skyrange.__path__, "skyrange."):
        found |= {one for one in vars(importlib.import_module(module.name)).values() if isinstance(one, Dispatcher)}
    assert len({compute_key(one) for one in found}) == len(found) > 400
