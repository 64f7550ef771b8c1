"""Validation errors as problems of a scenario: path of the key, its field, value, expected value, unit, hint."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import UnionType
from typing import Annotated, Any, Final, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.whole_numbers import parse_whole

UNIT_NAMES = {
    "m": "metres",
    "mps": "m/s",
    "s": "seconds",
    "ms": "milliseconds",
    "deg": "degrees",
    "hz": "Hz",
    "bps": "bit/s",
    "bytes": "bytes",
}
"""Unit suffixes of the keys of a scenario."""

_TO_OURS = {
    ("ft", "m"): 0.3048,
    ("feet", "m"): 0.3048,
    ("km", "m"): 1000.0,
    ("cm", "m"): 0.01,
    ("mm", "m"): 0.001,
    ("mi", "m"): 1609.344,
    ("kmh", "mps"): 1 / 3.6,
    ("kph", "mps"): 1 / 3.6,
    ("kts", "mps"): 1852 / 3600,
    ("kt", "mps"): 1852 / 3600,
    ("knots", "mps"): 1852 / 3600,
    ("mph", "mps"): 0.44704,
    ("ms", "s"): 1e-3,
    ("us", "s"): 1e-6,
    ("ns", "s"): 1e-9,
    ("min", "s"): 60.0,
    ("h", "s"): 3600.0,
    ("s", "ms"): 1e3,
    ("us", "ms"): 1e-3,
    ("ns", "ms"): 1e-6,
    ("rad", "deg"): 180 / math.pi,
    ("kbps", "bps"): 1e3,
    ("mbps", "bps"): 1e6,
    ("khz", "hz"): 1e3,
    ("kb", "bytes"): 1e3,
}
"""Exact factors of the international foot, statute and nautical mile (1959 agreement; BIPM SI brochure, table 8)."""

UNIT_SUFFIXES: Final = sorted({*UNIT_NAMES, *(unit for unit, _ in _TO_OURS)}, key=len, reverse=True)
"""Every unit suffix that a key may have, the longest first."""
_QUANTITY = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z/°]*)\s*$")
_SPELLINGS = {"m/s": "mps", "km/h": "kmh", "°": "deg", "sec": "s", "metres": "m", "meters": "m", "foot": "ft"}


def split_unit(key: str) -> tuple[str, str]:
    """A key's stem and unit suffix, "" if it has none: `alt_m` is ("alt", "m")."""
    stem, _, last = key.rpartition("_")
    return (stem, last.lower()) if stem and last.lower() in UNIT_SUFFIXES else (key, "")


def suggest_key(key: str, value: object, known: Iterable[str]) -> tuple[str, str] | None:
    """The known key that differs from `key` only in the unit, and a hint that converts `value`; None without one."""
    stem, unit = split_unit(key)
    for candidate in known:
        other_stem, other_unit = split_unit(candidate)
        if candidate != key and other_unit and stem.lower() == other_stem.lower():
            return candidate, _as(value, unit, candidate, other_unit)
    return None


def suggest_number(text: str, key: str) -> str:
    """A hint for a number in quotes at `key`; "" if the text is not a number."""
    match = _QUANTITY.match(text)
    if match is None:
        return ""
    number, unit = float(match[1]), _SPELLINGS.get(match[2].lower(), match[2].lower())
    expected_unit = split_unit(key)[1]
    if not unit or unit == expected_unit:
        return f"Write {key} = {match[1]}" + (
            f" without quotes, in {_name_unit(expected_unit)}." if expected_unit else " without quotes."
        )
    if not expected_unit:
        return "Write a number without quotes and without a unit."
    return _as(number, unit, key, expected_unit)


def _as(value: object, unit: str, key: str, expected_unit: str) -> str:
    factor = _TO_OURS.get((unit, expected_unit))
    if unit == "" or unit == expected_unit:
        factor = 1.0 if unit else None
    if factor is not None and isinstance(value, (int, float)) and not isinstance(value, bool):
        return f"Write {key} = {value * factor:.10g}, in {_name_unit(expected_unit)}."
    return f"Write {key}, in {_name_unit(expected_unit)}."


def _name_unit(suffix: str) -> str:
    """The name of a unit; the suffix itself for one that only files other than scenarios have."""
    return UNIT_NAMES.get(suffix, suffix)


def model_of(annotation: Any) -> type[BaseModel] | None:
    """The model class of this type; None if it is not a model."""
    for option in _options(annotation):
        if isinstance(option, type) and issubclass(option, BaseModel):
            return option
    return None


def element_of(annotation: Any) -> Any | None:
    """The type of the elements; None if this is not a sequence of any length."""
    for option in _options(annotation):
        if get_origin(option) is tuple and get_args(option)[1:] == (...,):
            return get_args(option)[0]
    return None


def value_of(annotation: Any) -> Any | None:
    """The type of the values; None if this is not a table with free keys."""
    for option in _options(annotation):
        if get_origin(option) is dict:
            return get_args(option)[1]
    return None


def type_below(annotation: Any, key: str | int) -> Any | None:
    """The type one level below, at the name of a field, the index of an element or the key of a table; else None."""
    if isinstance(key, int):
        return element_of(annotation)
    model = model_of(annotation)
    if model is not None:
        field = model.model_fields.get(key)
        return None if field is None else field.annotation
    return value_of(annotation)


def type_at(root: Any, keys: Iterable[str | int]) -> Any | None:
    """The type at a path below `root`; None if the path leaves the model."""
    for key in keys:
        if root is None:
            return None
        root = type_below(root, key)
    return root


def field_at(root: Any, keys: tuple[str | int, ...]) -> FieldInfo | None:
    """The field at the end of a path; if the path ends inside the value of a field, that field."""
    field = None
    for depth, key in enumerate(keys):
        model = model_of(root)
        if model is not None and isinstance(key, str) and key in model.model_fields:
            field = model.model_fields[key]
        root = type_below(root, keys[depth])
        if root is None:
            break
    return field


def _options(annotation: Any) -> list[Any]:
    """The alternatives of a type, without annotations."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) in (Union, UnionType):
        return [option for part in get_args(annotation) for option in _options(part)]
    return [annotation]


Loc = tuple[str | int, ...]
Between = Callable[[Any], list[Problem]]
"""Finds problems between the parts of a table, also if values in it are invalid."""

MAX_EXPLAINED = 1_000
"""Problems of one scenario that are explained."""

_EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "text in quotes",
    "dict_type": "a table",
    "model_type": "a table",
    "tuple_type": "a list",
    "datetime_type": "a date and time such as 2026-01-01T12:00:00Z",
    "is_instance_of": "a date and time such as 2026-01-01T12:00:00Z",
    "finite_number": "a finite number",
}


def input_error(
    who: str, error: ValidationError, model: type[BaseModel], data: Any, between: Between | None = None
) -> InputError:
    """The InputError with every problem that pydantic found in `data`, each once."""
    return InputError(who, explain_errors(error, model, data, between))


def explain_errors(
    error: ValidationError, model: type[BaseModel], data: Any, between: Between | None = None
) -> list[Problem]:
    """All problems, in the order of the model's keys; those of `between` too, unless pydantic validated the whole."""
    try:
        details = error.errors(include_url=False)
    except UnicodeEncodeError as bad:  # a lone surrogate, which a program or a shell can pass
        return [Problem("text", ascii(bad.object), "text that can be encoded as UTF-8")]
    if len(details) > MAX_EXPLAINED:  # the rest is counted, not explained: to look for near names takes time
        rest = f"{len(details) - MAX_EXPLAINED:,} more problems"
        return [*_explain(details[:MAX_EXPLAINED], model, data, None), Problem("further on", rest, "none")]
    return _explain(details, model, data, between)


def _explain(
    details: Sequence[ErrorDetails], model: type[BaseModel], data: Any, between: Between | None
) -> list[Problem]:
    problems = []
    renamed: set[Loc] = set()
    for detail in details:
        if detail["type"] == "extra_forbidden":
            problem, instead = _unknown_key(detail, model, data)
            problems.append(problem)
            if instead:
                renamed.add((*detail["loc"][:-1], instead))
    if between is not None and not any(d["type"] == "skyrange" and not d["loc"] for d in details):
        problems += [Problem(spell_path(_path(fault.where), data), *_rest(fault)) for fault in between(data)]
    for detail in details:
        if detail["type"] == "skyrange":
            problems += [
                Problem(
                    spell_path((*_trim(detail["loc"], model), *_path(fault.where)), data) or "scenario", *_rest(fault)
                )
                for fault in detail["ctx"]["problems"]
            ]
        elif detail["type"] == "missing" and detail["loc"] in renamed:
            continue
        elif detail["type"] == "too_short" and any(_below(other["loc"], detail["loc"]) for other in details):
            continue  # pydantic counts only the valid elements
        elif detail["type"] != "extra_forbidden":
            problems.append(_fault(detail, model, data))
    return list(dict.fromkeys(problems))


def spell_path(loc: Loc, data: Any) -> str:
    """A path in the form of `--set`: dotted, with the id of an element, if it has one, in place of its index."""
    parts = []
    for key in loc:
        data = _down(data, key)
        name = (data.get("id") if isinstance(data, Mapping) else getattr(data, "id", None)) if _index(key) else None
        parts.append(name if isinstance(name, str) and name else str(key))
    return ".".join(parts)


def _index(key: str | int) -> bool:
    return isinstance(key, int)


def _down(data: Any, key: str | int) -> Any:
    if isinstance(data, Mapping):
        return data.get(key)
    if isinstance(data, (list, tuple)):
        return data[key] if isinstance(key, int) and key < len(data) else None
    return getattr(data, key, None) if isinstance(key, str) else None


def _below(loc: Loc, above: Loc) -> bool:
    return len(loc) > len(above) and loc[: len(above)] == above


def _rest(fault: Problem) -> tuple[str, str, str]:
    return fault.value, fault.expected, fault.hint


def _path(where: str) -> Loc:
    parts = [part for part in where.split(".") if part]
    return tuple(part if (index := parse_whole(part)) is None else index for part in parts)


def _trim(loc: Loc, model: type[BaseModel]) -> Loc:
    """The path without the names that pydantic adds for the branches of a union."""
    kept: list[str | int] = []
    for key in loc:
        if type_at(model, [*kept, key]) is None and (
            isinstance(key, str) or model_of(type_at(model, kept)) is not None
        ):
            break
        kept.append(key)
    return tuple(kept)


def _unknown_key(detail: ErrorDetails, model: type[BaseModel], data: Any) -> tuple[Problem, str]:
    """The problem, and the key that was meant if only the unit is wrong, else ""."""
    loc = detail["loc"]
    inside = model_of(type_at(model, loc[:-1]))
    known = list(inside.model_fields) if inside is not None else []
    key, value = str(loc[-1]), detail["input"]
    unit = suggest_key(key, value, known)
    hint = unit[1] if unit else nearest(key, known)
    shown = f"{key} = {_shown(value)}"
    return Problem(spell_path(loc, data), shown, "a known key", hint), unit[0] if unit else ""


def _fault(detail: ErrorDetails, model: type[BaseModel], data: Any) -> Problem:
    kind, loc, value = detail["type"], _trim(detail["loc"], model), detail["input"]
    field = field_at(model, loc)
    about = f" ({_first_sentence(field.description)})" if field is not None and field.description else ""
    where = spell_path(loc, data)
    if kind == "missing":
        return Problem(where, "missing", f"a value{about}")
    ctx = detail.get("ctx", {})
    hint = ""
    if kind in ("float_type", "int_type") and isinstance(value, str) and loc:
        hint = suggest_number(value, str(next(key for key in reversed(loc) if isinstance(key, str))))
    if kind == "literal_error":
        options = [option.strip(" '") for option in ctx["expected"].replace(" or ", ", ").split(",")]
        return Problem(where, _shown(value), " or ".join(map(repr, options)), nearest(str(value), options))
    if kind == "string_pattern_mismatch":
        expected = _id_of(ctx["pattern"]) if loc[-1] == "id" else f"text that matches {ctx['pattern']}"
    else:
        expected = _EXPECTED.get(kind) or _bound(kind, ctx) or detail["msg"].removeprefix("Input should be ").lower()
    return Problem(where, _shown(value), f"{expected}{about}", hint)


def _id_of(pattern: str) -> str:
    """A description of an id's pattern, which ends in the number of characters that may follow the first."""
    most = int(pattern.rsplit(",", 1)[1].rstrip("}$")) + 1
    return f"at most {most} letters, digits, '-' or '_', the first a letter or digit"


def _bound(kind: str, ctx: Mapping[str, Any]) -> str:
    bounds = {
        "greater_than": ("gt", "more than {}"),
        "greater_than_equal": ("ge", "at least {}"),
        "less_than": ("lt", "less than {}"),
        "less_than_equal": ("le", "at most {}"),
        "too_short": ("min_length", "a list of at least {} element(s)"),
        "too_long": ("max_length", "a list of at most {} element(s)"),
        "string_too_short": ("min_length", "at least {} character(s)"),
        "string_too_long": ("max_length", "at most {} characters"),
    }
    if kind not in bounds:
        return ""
    key, text = bounds[kind]
    number = ctx[key]
    return text.format(f"{number:.10g}" if isinstance(number, float) else number)


def _first_sentence(text: str) -> str:
    return text.split("; ", 1)[0].split(". ", 1)[0].rstrip(".").split("\n", 1)[0]


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
