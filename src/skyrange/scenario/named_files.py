"""Files that a scenario names: their paths relative to the scenario file, and checks that they exist."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from skyrange.core.errors import MAX_LINES, InputError, Problem, nearest
from skyrange.core.input_files import MAX_TEXT_BYTES, expand_user, read_input
from skyrange.scenario.validation.error_messages import spell_path

FILE_KEYS = frozenset({"file", "buildings", "table"})
"""Keys whose value is the name of a file that the run reads; parameters of plugins too."""


def read_text(path: Path, who: str) -> str:
    """The content of a text file. Raises InputError if it is missing, not a file, unreadable or not UTF-8."""
    fault = check_file(path, "file")
    if fault is not None:
        raise InputError(who, [fault])
    try:
        return read_input(path, who, max_bytes=MAX_TEXT_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError.one(who, f"byte {error.start}", hex(error.object[error.start]), "UTF-8 text") from None


def check_file(path: Path, where: str, *, suggest: bool = True) -> Problem | None:
    """The problem of a file that does not exist, None if it exists; with `suggest`, with the nearest name beside it."""
    try:
        if path.is_file():
            return None
        if path.exists():
            return Problem(
                where, str(path), "a file", "It is a folder." if path.is_dir() else "It is a pipe or a device."
            )
        siblings = [one.name for one in path.parent.iterdir()] if suggest and path.parent.is_dir() else []
        hint = nearest(path.name, siblings) if len(siblings) <= 1000 else ""
        return Problem(where, str(path), "a file that exists", hint if hint.startswith("Did you") else "")
    except (OSError, ValueError) as error:
        return Problem(where, str(path), f"a valid file name ({error})")


def locate_files(data: Mapping[str, Any], folder: Path) -> tuple[dict[str, Any], list[Problem]]:
    """`data` with the names of files made absolute from `folder`, and a problem for each file that does not exist."""
    faults: list[Problem] = []

    def visit(part: Any, loc: tuple[str | int, ...]) -> Any:
        if isinstance(part, Mapping):
            return {key: visit(value, (*loc, key)) for key, value in part.items()}
        if isinstance(part, (list, tuple)):
            return [visit(value, (*loc, index)) for index, value in enumerate(part)]
        if isinstance(part, str) and part and loc[-1] in FILE_KEYS:
            path = folder / expand_user(part)
            fault = check_file(path, spell_path(loc, data), suggest=len(faults) < MAX_LINES)
            if fault is not None:
                faults.append(fault)
            return str(path.absolute())
        return part

    return visit(data, ()), faults


def list_named_files(data: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The key and the value of everything in `data` that names a file, at any depth."""
    for key, part in data.items():
        if isinstance(part, str) and part and key in FILE_KEYS:
            yield key, part
        elif isinstance(part, Mapping):
            yield from list_named_files(part)
        elif isinstance(part, (list, tuple)):
            for one in part:
                if isinstance(one, Mapping):
                    yield from list_named_files(one)


def rename_files(data: dict[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """`data` with the names of files replaced by those that `names` has for them."""

    def visit(part: Any, key: str) -> Any:
        if isinstance(part, dict):
            return {name: visit(value, name) for name, value in part.items()}
        if isinstance(part, list):
            return [visit(value, "") for value in part]
        return names.get(part, part) if isinstance(part, str) and key in FILE_KEYS else part

    return {key: visit(value, key) for key, value in data.items()}
