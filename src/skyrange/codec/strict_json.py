"""JSON of peers, read strictly (RFC 8259): one reader for all messages and bodies that are not read into a model."""

from __future__ import annotations

import math
from typing import Any, Final

from pydantic_core import from_json

from skyrange.core.errors import DecodeError

MAX_DEPTH: Final = 64
"""Deepest nesting of arrays and objects."""


def parse_json(data: bytes | str, max_depth: int = MAX_DEPTH) -> Any:
    """The value in JSON text.

    Raises `DecodeError` for any other bytes, and for JSON that not every program can read or write again: not UTF-8,
    lone surrogates, NaN, Infinity, numbers beyond double precision or of thousands of digits, and deep nesting.
    """
    try:
        value = from_json(data, allow_inf_nan=False)
    except ValueError as error:
        raise DecodeError(f"no JSON: {error}"[:200]) from error
    level, depth = [value], 0
    while level:
        below: list[Any] = []
        deeper = False
        for item in level:
            if type(item) is dict:
                deeper = True
                below.extend(item.values())
            elif type(item) is list:
                deeper = True
                below.extend(item)
            elif type(item) is float and not math.isfinite(item):
                raise DecodeError("no JSON: a number beyond double precision")
        depth += deeper
        if depth > max_depth:
            raise DecodeError(f"no JSON: nested more than {max_depth} deep")
        level = below
    return value


def parse_json_object(data: bytes | str, max_depth: int = MAX_DEPTH) -> dict[str, Any]:
    """The object in JSON text. Raises `DecodeError` as `parse_json`, and for another value."""
    value = parse_json(data, max_depth)
    if not isinstance(value, dict):
        raise DecodeError("JSON, but not an object")
    return value
