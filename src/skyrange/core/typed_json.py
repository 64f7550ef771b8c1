"""JSON of the files that skyrange writes, checked against a type: a model, a dataclass or an annotation.

What a reader gets has the keys and types that it relies on, whoever wrote the file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field, TypeAdapter, ValidationError

from skyrange.core.errors import InputError, Problem
from skyrange.core.files import MAX_RECORD_BYTES, parse_json, read_input

Int64 = Annotated[int, Field(ge=-(2**63), lt=2**63)]
"""A whole number that tables can hold."""
Count = Annotated[int, Field(ge=0, lt=2**63)]
"""A number of things."""
Finite = Annotated[float, Field(allow_inf_nan=False)]
"""A number that is neither infinite nor NaN."""

_DAMAGED: Final = "The file was changed by hand or is damaged."


def read_object(path: Path, who: str, where: str, *, expected: str = "a file") -> dict[str, Any]:
    """The JSON object in a file. Raises `InputError` in the name of `who` for anything else."""
    data = parse_json(read_input(path, who, where, max_bytes=MAX_RECORD_BYTES, expected=expected), who, where)
    if not isinstance(data, dict):
        raise InputError.one(who, where, type(data).__name__, "a JSON object", _DAMAGED)
    return data


def read_formatted(path: Path, file_format: str, who: str, where: str, *, remedy: str) -> dict[str, Any]:
    """The JSON object in a file whose `format` is `file_format`, such as "skyrange.plan/1".

    Raises `InputError` in the name of `who`, with `remedy` for the same format of another version.
    """
    data = read_object(path, who, where, expected=f"a file of the format {file_format}")
    found = data.get("format")
    if found != file_format:
        other = isinstance(found, str) and found.startswith(f"{file_format.partition('/')[0]}/")
        hint = f"It was written by another version of skyrange: {remedy}" if other else ""
        known = found is None or _is_format(found)  # nothing of another file is quoted
        raise InputError.one(who, f"{where}: format", repr(found) if known else "another", repr(file_format), hint)
    return data


def _is_format(value: Any) -> bool:
    return isinstance(value, str) and re.fullmatch(r"skyrange\.[a-z_]{1,20}/\d{1,4}", value) is not None


def check_type(data: Any, kind: Any, who: str, where: str, *, hint: str = _DAMAGED) -> Any:
    """`data`, as `json.loads` has it, as a value of the type `kind`.

    Raises `InputError` in the name of `who` with a problem for each key of the file `where` that is not as it declares.
    """
    try:
        return _adapter_of(kind).validate_python(data)
    except ValidationError as error:
        raise InputError(who, list(_explain(error, where, hint))) from None


def require_type(data: Any, kind: Any, who: str, where: str, *, hint: str = _DAMAGED) -> None:
    """Raise `InputError` as `check_type`, for those who go on with `data` itself: nothing is converted."""
    try:
        _adapter_of(kind).validate_python(data, strict=True)
    except ValidationError as error:
        raise InputError(who, list(_explain(error, where, hint))) from None


def _explain(error: ValidationError, where: str, hint: str) -> Iterator[Problem]:
    for fault in error.errors(include_url=False, include_context=False):
        key = ".".join(map(str, fault["loc"]))
        value = _quote(fault["input"], is_missing=fault["type"] == "missing")
        yield Problem(f"{where}: {key}" if key else where, value, _expect(fault["msg"]), hint)


@cache
def _adapter_of(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _quote(value: Any, *, is_missing: bool) -> str:
    if is_missing:
        return "missing"
    return type(value).__name__ if isinstance(value, Mapping | list) else ascii(value)[:80]


def _expect(message: str) -> str:
    return {"Field required": "a value", "Extra inputs are not permitted": "no such key"}.get(
        message, message.removeprefix("Input should be ").replace("valid ", "")
    )
