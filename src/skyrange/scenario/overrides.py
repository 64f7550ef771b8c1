"""Overrides: `--set path=value` changes the table of a scenario, or of a study, before it is built.

A path consists of dotted keys. An element of a list is named by its id, or by its name if it has no id, or its index
from 0, and `*` means all elements.
A key that contains dots is written in quotes: `approvals."acme.first-come".later_s`. Values are TOML; a bare word or a
file name that is not TOML is text.
"""

from __future__ import annotations

import copy
import json
import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.files import expand_user
from skyrange.core.whole_numbers import parse_whole
from skyrange.scenario.model.operators import operator_names, vehicle_names
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.named_files import FILE_KEYS
from skyrange.scenario.validation.error_messages import element_of, model_of, type_below, value_of

_KEY = re.compile(r'"([^"]+)"|([^."]+)')


def apply_overrides(
    data: Mapping[str, Any], assignments: Iterable[str], root: type[BaseModel] = Scenario
) -> dict[str, Any]:
    """A copy of `data`, the table of a `root`, with every `path=value` applied, in order.

    File names are relative to the working directory, as in a shell. Raises InputError with one problem for every
    assignment that is malformed or matches nothing; values are checked when the scenario is built.
    """
    changed: dict[str, Any] = copy.deepcopy(dict(data))
    problems = []
    for assignment in assignments:
        path, equals, text = assignment.partition("=")
        keys = _keys(path.strip())
        if not equals or not keys:
            problems.append(Problem(assignment, "not an assignment", "path=value, such as seed=7"))
            continue
        try:
            value = parse_value(text.strip())
        except ValueError as error:
            problems.append(
                Problem(path, text.strip(), f"a TOML value ({error})", 'Write text that contains spaces in "quotes".')
            )
            continue
        if keys[-1] in FILE_KEYS and isinstance(value, str):
            value = str(expand_user(value).absolute())
        problem = _assign(changed, root, keys, value)
        if problem is not None:
            problems.append(problem)
    if problems:
        raise InputError("--set", problems)
    return changed


def read_assignment(assignment: str) -> tuple[str, Any] | None:
    """The last key and the value of `path=value`; None if it is malformed, which `apply_overrides` reports."""
    path, equals, text = assignment.partition("=")
    keys = _keys(path.strip())
    if not equals or not keys:
        return None
    try:
        return keys[-1], parse_value(text.strip())
    except ValueError:
        return None


def set_key(key: str, value: Any) -> str:
    """The `key=value` that sets a key; raises `InputError` for a number that is not finite."""
    return f"{key}={_toml(value)}"


def _toml(value: Any) -> str:
    """A value as TOML on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        if not math.isfinite(value):
            raise InputError.one("--set", "value", repr(value), "a finite number")
        return repr(value)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{json.dumps(key)} = {_toml(item)}' for key, item in value.items())}}}"
    # whole numbers and text are the same in both, but TOML has no surrogate pairs, and no unescaped DEL
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def locate_assignment(assignment: str, folder: Path) -> str:
    """`path=value` with the name of a file made absolute from `folder`; any other assignment as it is."""
    parsed = read_assignment(assignment)
    if parsed is None or parsed[0] not in FILE_KEYS or not isinstance(parsed[1], str) or not parsed[1]:
        return assignment
    return set_key(assignment.partition("=")[0], str((folder / expand_user(parsed[1])).absolute()))


def _keys(path: str) -> list[str]:
    """The keys of a dotted path, without quotes; empty if the path is malformed."""
    keys, at = [], 0
    while (match := _KEY.match(path, at)) is not None:
        keys.append(match[1] or match[2])
        at = match.end()
        if at == len(path):
            return keys
        if path[at] != ".":
            break
        at += 1
    return []


def parse_value(text: str) -> Any:
    """A TOML value, or the text itself if it is a bare word. Raises ValueError for anything else."""
    if not text or "\n" in text or "\r" in text:
        raise ValueError("the value must be on one line")
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        if text[0] in "\"'[{#" or any(char in text for char in "\"'[]{}#,= \t"):
            raise ValueError(str(error).split(" (at ")[0] or "too many levels of nesting") from None
        return text
    return parsed["value"]


class _NoMatchError(Exception):
    def __init__(self, fault: Problem) -> None:
        self.fault = fault


def _assign(data: dict[str, Any], root: type[BaseModel], keys: Sequence[str], value: Any) -> Problem | None:
    """Set `value` at every place that `keys` matches. Returns a problem if there is no such place."""
    try:
        matched = False
        for table, key in _places(data, root, keys, ()):
            table[key] = copy.deepcopy(value)
            matched = True
    except _NoMatchError as error:
        return error.fault
    if not matched:
        return Problem(".".join(keys), "matches nothing", f"the path of a key in this {root.__name__.lower()}")
    return None


def _places(part: Any, annotation: Any, keys: Sequence[str], above: tuple[str, ...]) -> Iterator[tuple[Any, Any]]:
    """Every (table or list, key) that the rest of the path matches. Missing tables on the path are created."""
    key, rest = keys[0], keys[1:]
    here = (*above, key)
    if element_of(annotation) is not None:
        part = part if isinstance(part, list) else []
        for index in _elements(part, above, key, here):
            if rest:
                yield from _places(part[index], element_of(annotation), rest, here)
            else:
                yield part, index
        return
    if not isinstance(part, dict):
        raise _NoMatchError(_no_table(here))
    for name in _names(part, annotation, key, here):
        if not rest:
            yield part, name
            continue
        below = type_below(annotation, name)
        if model_of(below) is not None or value_of(below) is not None:
            existing = part.get(name)
            if existing is None:
                existing = part[name] = {}
            yield from _places(existing, below, rest, here)
        else:
            yield from _places(part.get(name), below, rest, here)


def _names(part: Mapping[str, Any], annotation: Any, key: str, here: tuple[str, ...]) -> list[str]:
    """The keys of a table that `key` stands for: itself, or all keys for `*`."""
    model = model_of(annotation)
    if key == "*":
        return list(part)
    if model is None and value_of(annotation) is None:
        raise _NoMatchError(_no_table(here))
    if model is not None and key not in model.model_fields:
        raise _NoMatchError(Problem(".".join(here), key, "a known key", nearest(key, model.model_fields)))
    return [key]


def _no_table(here: tuple[str, ...]) -> Problem:
    """The problem of a path that goes on below a value that is not a table."""
    above = ".".join(here[:-1])
    return Problem(".".join(here), f"{above} has no keys", f"a path that ends at {above}")


def _elements(part: Sequence[Any], above: tuple[str, ...], key: str, here: tuple[str, ...]) -> list[int]:
    """The indices in a list that `key` stands for: by id, by index, or all for `*`."""
    if key == "*":
        return list(range(len(part)))
    ids = _ids(part, above)
    if key in ids:
        return [index for index, name in enumerate(ids) if name == key]
    index = parse_whole(key)
    if index is not None and index < len(part):
        return [index]
    known = [name for name in ids if name]
    hint = nearest(key, known) or (f"The indices are 0 to {len(part) - 1}." if part else "The list is empty.")
    raise _NoMatchError(Problem(".".join(here), key, "an id, an index from 0, or *", hint))


def _ids(part: Sequence[Any], above: tuple[str, ...]) -> list[str]:
    """The ids of the elements, with the default ids that the scenario gives to elements without one."""
    tables = [element if isinstance(element, dict) else {} for element in part]
    given = [name if isinstance(name := table.get("id", table.get("name", "")), str) else "" for table in tables]
    if above == ("operators",):
        colors = [color if isinstance(color := table.get("color", ""), str) else "" for table in tables]
        return [name for name, _ in operator_names(zip(given, colors, strict=True))]
    if above[-1:] == ("vehicles",):
        return vehicle_names(above[-2], given) if above[-2] != "*" else given
    return given
