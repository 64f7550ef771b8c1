"""Files that a scenario names: their paths relative to the scenario file, and checks that they exist."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from skyrange.core.errors import MAX_LINES, InputError, Problem, nearest
from skyrange.core.files import MAX_TEXT_BYTES, expand_user, read_input
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
        siblings = [sibling.name for sibling in path.parent.iterdir()] if suggest and path.parent.is_dir() else []
        hint = nearest(path.name, siblings) if len(siblings) <= 1000 else ""
        return Problem(where, str(path), "a file that exists", hint if hint.startswith("Did you") else "")
    except (OSError, ValueError) as error:
        return Problem(where, str(path), f"a valid file name ({error})")


def _change_files(data: Mapping[str, Any], change: Callable[[str, tuple[str | int, ...]], str]) -> dict[str, Any]:
    """A copy of `data` with `change(name, path)` for the name of each file, at any depth."""

    def visit(part: Any, path: tuple[str | int, ...]) -> Any:
        if isinstance(part, Mapping):
            return {key: visit(value, (*path, key)) for key, value in part.items()}
        if isinstance(part, (list, tuple)):
            return [visit(value, (*path, index)) for index, value in enumerate(part)]
        return change(part, path) if isinstance(part, str) and part and path[-1] in FILE_KEYS else part

    return {key: visit(value, (key,)) for key, value in data.items()}


def locate_files(data: Mapping[str, Any], folder: Path) -> tuple[dict[str, Any], list[Problem]]:
    """`data` with the names of files made absolute from `folder`, and a problem for each file that does not exist."""
    problems: list[Problem] = []

    def locate(name: str, path: tuple[str | int, ...]) -> str:
        file = folder / expand_user(name)
        fault = check_file(file, spell_path(path, data), suggest=len(problems) < MAX_LINES)
        if fault is not None:
            problems.append(fault)
        return str(file.absolute())

    return _change_files(data, locate), problems


def list_named_files(data: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The key and the value of everything in `data` that names a file, at any depth."""
    named_files: list[tuple[str, str]] = []

    def note(name: str, path: tuple[str | int, ...]) -> str:
        named_files.append((str(path[-1]), name))
        return name

    _change_files(data, note)
    return named_files


def rename_files(data: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """`data` with the names of files replaced by those that `names` has for them."""
    return _change_files(data, lambda name, _: names.get(name, name))
