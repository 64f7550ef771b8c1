"""Keys of compiled functions for the cache: digests of everything that numba compiles of a function and of its callees.

A key covers the bytecode of the function with the constants that it loads, its defaults, its closure, its options, the
values of its global names, and all this of every compiled function that it calls, directly or not. It does not cover
comments, docstrings, line numbers, or the place and the time of a file.

Keys are computed from the loaded functions and not from their files, because a file may be edited after it was loaded.
"""

from __future__ import annotations

import builtins
import dis
import sys
from collections.abc import Iterator
from functools import cache
from hashlib import blake2b
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, Final, NamedTuple

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.types import ExternalFunction

_PACKAGE: Final = __name__.partition(".")[0]
_EXTENDED: Final = dis.EXTENDED_ARG
_LOAD_GLOBAL: Final = dis.opmap["LOAD_GLOBAL"]
_LOADS_CONSTANT: Final = frozenset(dis.hasconst)
_VERSIONS: Final = f"python {sys.version_info[:2]}, numba {numba.__version__}, numpy {np.__version__}"


class _Description(NamedTuple):
    """Digest of a function without its callees, and these in the order in which the digest names them."""

    digest: bytes
    callees: tuple[Dispatcher, ...]


def compute_key(function: Dispatcher, *, anew: bool = False) -> str:
    """The key of a compiled function. `anew` reads all values again; otherwise each function is read once.

    Raises `TypeError` for a global name with a value that has no digest.
    """
    describe = _describe if anew else _describe_once
    numbers = {function: 0}
    reached = [function]
    digest = blake2b(_VERSIONS.encode(), digest_size=12)
    for one in reached:  # grows: a cycle of calls ends because each function is reached once
        description = describe(one)
        digest.update(description.digest)
        for callee in description.callees:
            if callee not in numbers:
                numbers[callee] = len(reached)
                reached.append(callee)
            digest.update(numbers[callee].to_bytes(4, "little"))
    return digest.hexdigest()


def find_callees(function: Dispatcher) -> tuple[Dispatcher, ...]:
    """The compiled functions that a compiled function names, each as often as it does."""
    return _describe_once(function).callees


def _describe(dispatcher: Dispatcher) -> _Description:
    function = dispatcher.py_func
    callees: list[Dispatcher] = []
    known = function.__globals__
    try:
        parts = (
            _name(function),
            sorted((name, str(value)) for name, value in dispatcher.targetoptions.items()),
            _describe_code(function.__code__, known, callees),
            _describe_value(function.__defaults__, known, callees),
            _describe_value(tuple((function.__kwdefaults__ or {}).items()), known, callees),
            _describe_value(tuple(one.cell_contents for one in function.__closure__ or ()), known, callees),
        )
    except TypeError as error:
        raise TypeError(
            f"compiled function {_name(function)}: {error}; expected compiled functions, numbers, strings, arrays, "
            "tuples of these, NamedTuple classes, modules, and functions and types of other packages; pass the value "
            "as an argument"
        ) from None
    return _Description(blake2b(repr(parts).encode(), digest_size=16).digest(), tuple(callees))


_describe_once = cache(_describe)


def _describe_code(code: CodeType, known: dict[str, Any], callees: list[Dispatcher]) -> tuple[Any, ...]:
    """The code, and the constants and global values that it loads. It does not load its docstring."""
    loaded: list[Any] = []
    for operation, argument in _operations(code.co_code):
        if operation in _LOADS_CONSTANT:
            loaded.append(_describe_value(code.co_consts[argument], known, callees))
        elif operation == _LOAD_GLOBAL:
            name = code.co_names[argument >> 1]  # the lowest bit is a flag
            try:
                loaded.append(_describe_global(name, code, known, callees))
            except TypeError as error:
                raise TypeError(f"global {name}: {error}") from None
    shape = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags)
    names = (code.co_names, code.co_varnames, code.co_cellvars, code.co_freevars)
    return code.co_code, code.co_exceptiontable, shape, names, loaded


def _operations(code: bytes) -> Iterator[tuple[int, int]]:
    high = 0
    for operation, low in zip(code[::2], code[1::2], strict=True):
        argument = high | low
        high = argument << 8 if operation == _EXTENDED else 0
        yield operation, argument


def _describe_global(name: str, code: CodeType, known: dict[str, Any], callees: list[Dispatcher]) -> Any:
    if name not in known:
        return _describe_value(getattr(builtins, name, None), known, callees)
    value = known[name]
    if isinstance(value, ModuleType) and _is_own(value.__name__):
        attributes = tuple((one, vars(value)[one]) for one in code.co_names if one in vars(value))
        return value.__name__, _describe_value(attributes, known, callees)
    return _describe_value(value, known, callees)


def _describe_value(value: Any, known: dict[str, Any], callees: list[Dispatcher]) -> Any:
    """Text, bytes, and tuples and lists of these, which differ whenever numba would compile something else."""
    kind = type(value)
    if value is None or value is Ellipsis or kind in (bool, int, float, complex, str, bytes):
        return kind.__name__, repr(value)
    if isinstance(value, Dispatcher):
        callees.append(value)
        return "compiled", _name(value.py_func)
    if kind is CodeType:
        return _describe_code(value, known, callees)
    if isinstance(value, tuple):
        return "tuple", _name(kind), [_describe_value(one, known, callees) for one in value]
    if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
        layout = value.flags.c_contiguous, value.flags.f_contiguous, value.flags.aligned
        return "array", _name(kind), repr(value.dtype), value.shape, layout, blake2b(value.tobytes()).digest()
    if isinstance(value, ExternalFunction):
        return "external", value.symbol, repr(value.sig)
    if kind is ModuleType and not _is_own(value.__name__):
        return "module", value.__name__
    if isinstance(value, type) and issubclass(value, tuple) and (fields := getattr(value, "_fields", None)):
        defaults = tuple(getattr(value, "_field_defaults", {}).items())
        return "named tuple", _name(value), fields, _describe_value(defaults, known, callees)
    other = isinstance(value, type | FunctionType | BuiltinFunctionType | np.ufunc)
    if other and not _is_own(getattr(value, "__module__", None) or ""):
        return kind.__name__, _name(value)
    raise TypeError(f"{value!r} of type {kind.__name__} has no digest")


def _is_own(module: str) -> bool:
    return module.partition(".")[0] == _PACKAGE


def _name(value: Any) -> str:
    return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', value.__name__)}"
