"""Types of arguments as JSON, and the list of kernels that flights use, each with the types that it is called with.

A kernel is a compiled function with the types of its arguments. The list, `kernels.json`, is made by
`tools/record_kernels.py`. Records and named tuples are in it by the name of their dtype or class, so that it still fits
when a field is added.
"""

from __future__ import annotations

import importlib
import json
import sys
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numba.core import types
from numba.core.dispatcher import Dispatcher
from numba.np.numpy_support import as_dtype, from_dtype
from pydantic import JsonValue

KERNELS: Final = Path(__file__).with_name("kernels.json")
_PACKAGE: Final = __name__.partition(".")[0]


class Kernel(NamedTuple):
    """A compiled function, and the types of its arguments: an entry of the list, and what it stands for."""

    name: str
    signature: list[JsonValue]
    function: Any  # a Dispatcher, which mypy takes for a method
    arguments: tuple[types.Type, ...]


def load_kernels() -> list[Kernel]:
    """The kernels of the list that this version has: a list that is old costs only time."""
    found: list[Kernel] = []
    for name, signatures in read_list().items():
        for signature in signatures:
            kernel = rebuild_kernel(name, signature)
            if kernel is not None:
                found.append(kernel)
    return found


def read_list() -> dict[str, list[list[JsonValue]]]:
    """The list as it is in its file: signatures by `module:function`."""
    listed: dict[str, list[list[JsonValue]]] = json.loads(KERNELS.read_bytes())
    return listed


def write_list(listed: dict[str, list[list[JsonValue]]]) -> None:
    """Write the list in its order: one line a signature."""
    blocks = [
        f"{json.dumps(name)}: [\n  " + ",\n  ".join(sorted(map(json.dumps, signatures))) + "\n]"
        for name, signatures in sorted(listed.items())
    ]
    KERNELS.write_text("{\n" + ",\n".join(blocks) + "\n}\n", encoding="utf-8")


def name_function(function: Dispatcher) -> str:
    """The name of a function in the list."""
    return _name(function.py_func)


def rebuild_kernel(name: str, signature: list[JsonValue]) -> Kernel | None:
    """The kernel of an entry of the list; None if this version has no such function or type."""
    function = _find_function(name)
    if function is None:
        return None
    try:
        return Kernel(name, signature, function, tuple(map(_rebuild, signature)))
    except (ImportError, AttributeError):
        return None


def describe_arguments(arguments: tuple[types.Type, ...]) -> list[JsonValue]:
    """Types of arguments as JSON. Raises `TypeError` for a type that cannot be rebuilt from it."""
    described = [_describe(one) for one in arguments]
    if tuple(map(_rebuild, described)) != tuple(arguments):
        raise TypeError(f"{arguments} are other types when rebuilt from {described}")
    return described


def _describe(kind: Any) -> JsonValue:
    if isinstance(kind, types.Literal):
        return {"literal": kind.literal_value}
    if isinstance(kind, types.Number | types.Boolean):
        return str(as_dtype(kind).name)
    if isinstance(kind, types.Record):
        return {"record": _name_record(kind) or _describe_fields(kind)}
    if isinstance(kind, types.NestedArray):
        return {"nested": _describe(kind.dtype), "shape": list(kind.shape)}
    if isinstance(kind, types.Array):
        array: dict[str, JsonValue] = {"array": _describe(kind.dtype), "ndim": kind.ndim, "layout": kind.layout}
        changes = {"readonly": not kind.mutable, "unaligned": not kind.aligned}
        return array | {name: True for name, holds in changes.items() if holds}
    if isinstance(kind, types.BaseTuple):
        of: Any = kind  # numba's base class does not declare the attributes of all its subclasses
        made = {"named": _name(of.instance_class)} if isinstance(kind, types.BaseNamedTuple) else {}
        return made | {"tuple": [_describe(one) for one in of.types]}
    raise TypeError(f"{kind!r} has no description")


def _rebuild(described: Any) -> Any:
    if isinstance(described, str):
        return from_dtype(np.dtype(described))
    if "literal" in described:
        return types.literal(described["literal"])  # type: ignore[no-untyped-call]
    if "record" in described:
        record = described["record"]
        return _find_record(record) if isinstance(record, str) else from_dtype(np.dtype(record))
    if "nested" in described:
        return types.NestedArray(_rebuild(described["nested"]), tuple(described["shape"]))
    if "array" in described:
        return types.Array(
            _rebuild(described["array"]),
            described["ndim"],
            described["layout"],
            readonly="readonly" in described,
            aligned="unaligned" not in described,
        )
    made = _find(described["named"]) if "named" in described else None
    return types.BaseTuple.from_types(tuple(map(_rebuild, described["tuple"])), made)  # type: ignore[no-untyped-call]


def _name_record(kind: types.Record) -> str:
    """The first name of a dtype in a module of the package; "" if it has none."""
    return _name_records().get(kind, "")


@cache
def _find_record(name: str) -> Any:
    return from_dtype(_find(name))


@cache
def _name_records() -> dict[types.Type, str]:
    names: dict[types.Type, str] = {}
    for name, module in sorted(sys.modules.items()):
        if name.partition(".")[0] == _PACKAGE:
            for key, value in vars(module).items():
                if isinstance(value, np.dtype) and value.names:
                    names.setdefault(from_dtype(value), f"{name}:{key}")
    return names


def _describe_fields(kind: types.Record) -> dict[str, JsonValue]:
    """A record of numbers, as numpy takes it."""
    dtype = as_dtype(kind)
    names = list(dtype.names or ())
    return {
        "names": list(names),
        "formats": [str(dtype[name].name) for name in names],
        "offsets": [dtype.fields[name][1] for name in names] if dtype.fields else [],
        "itemsize": dtype.itemsize,
    }


def _find_function(name: str) -> Dispatcher | None:
    try:
        found = _find(name)
    except (ImportError, AttributeError):
        return None
    return found if isinstance(found, Dispatcher) else None


def _name(value: Any) -> str:
    return f"{value.__module__}:{value.__qualname__}"


def _find(name: str) -> Any:
    """What a module of this package has by a name such as `skyrange.core.chance:philox`."""
    module, _, attribute = name.partition(":")
    if module.partition(".")[0] != _PACKAGE:
        raise ImportError(f"{module} is no module of {_PACKAGE}")
    return getattr(importlib.import_module(module), attribute)
