"""Members of a data set: the runs, each with its block, arm, split and factors."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import InputError, Problem
from skyrange.core.files import expand_user, read_input
from skyrange.core.ids import ID_PATTERN

Scalar = str | int | float | bool

SCENARIO: Final = "scenario.toml"
_MAX_BYTES: Final = 64 * 1024 * 1024
_KEYS: Final = frozenset({"folder", "block", "arm", "split", "factors", "seed", "effects_s"})


@dataclass(frozen=True, slots=True)
class Member:
    """One run of a data set."""

    record: Path
    """The run's folder."""
    block: str
    """All arms of one draw of a scenario have the same block. An id of letters, digits, `_` and `-`."""
    arm: str
    split: str
    """Such as train, validation or test; "" until `assign_splits`."""
    factors: Mapping[str, Scalar]
    """The study's factors, such as the city and the size of the fleet."""
    seed: int
    scenario: str
    """The text of the run's scenario file, from which it is flown again."""
    effects_s: Mapping[str, float | None] | None = field(default=None)
    """By vehicle, when it departed from the nominal twin in seconds, None for never; None if that is not known."""

    @property
    def run(self) -> str:
        """The id of the run in the data set: block and arm."""
        return f"{self.block}.{self.arm}"


def read_members(file: Path | str) -> list[Member]:
    """The members in a TOML or JSON file: a list `runs` of tables with `folder`, `block`, `arm` and, if wanted,
    `split`, `factors`, `seed` and `effects_s`.

    Folders are relative to the file. The scenario is that of the folder, and the seed is by default the scenario's.
    Raises `InputError` for what is missing, of another type, unknown, or there twice.
    """
    path = expand_user(file)
    who = str(path)
    data = read_input(path, who, max_bytes=_MAX_BYTES, expected="a TOML or JSON file of runs")
    try:
        value = tomllib.loads(data.decode()) if path.suffix == ".toml" else json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError.one(who, "file", str(error)[:200], "TOML or JSON") from error
    rows = value.get("runs") if isinstance(value, dict) else value
    if not isinstance(rows, list) or not rows:
        raise InputError.one(who, "runs", type(rows).__name__, "a list of runs, at least one")
    problems: list[Problem] = []
    members = [member for k, row in enumerate(rows) if (member := _member(path.parent, f"runs[{k}]", row, problems))]
    if problems:
        raise InputError(who, problems)
    check_members(members)
    return members


def _member(base: Path, where: str, row: Any, problems: list[Problem]) -> Member | None:
    before = len(problems)
    if not isinstance(row, dict):
        problems.append(Problem(where, type(row).__name__, "a table"))
        return None
    problems += [Problem(f"{where}.{key}", "unknown", f"one of {', '.join(sorted(_KEYS))}") for key in {*row} - _KEYS]
    for key, kind, default in _SHAPE:
        if not isinstance(row.get(key, default), kind):
            problems.append(Problem(f"{where}.{key}", repr(row.get(key)), f"{kind}"))
    if len(problems) > before:
        return None
    folder = base / expand_user(row["folder"])
    scenario = folder / SCENARIO
    if not scenario.is_file():
        problems.append(Problem(f"{where}.folder", str(folder), "the folder of a run with its scenario.toml"))
        return None
    text = read_input(scenario, str(folder), max_bytes=_MAX_BYTES).decode()
    seed = row.get("seed", tomllib.loads(text).get("seed", 0))
    effects = row.get("effects_s")
    return Member(
        folder, row["block"], row["arm"], row.get("split", ""), dict(row.get("factors", {})), int(seed), text,
        None if effects is None else {name: _effect_s(at) for name, at in effects.items()},
    )  # fmt: skip


def _effect_s(value: Any) -> float | None:
    return None if value in (None, "never") else float(value)


_SHAPE: Final[tuple[tuple[str, Any, Any], ...]] = (
    ("folder", str, None), ("block", str, None), ("arm", str, None), ("split", str, ""), ("factors", dict, {}),
    ("seed", int, 0), ("effects_s", dict, {}),
)  # fmt: skip


def check_members(members: list[Member]) -> None:
    """Raise `InputError` for a block or arm that is no id, and for an arm that a block has twice."""
    problems = []
    seen: set[str] = set()
    for member in members:
        for name, value in (("block", member.block), ("arm", member.arm)):
            if not ID_PATTERN.match(value) and not all(ID_PATTERN.match(part) for part in value.split("+")):
                problems.append(Problem(name, value, "an id of letters, digits, _ and -"))
        if member.run in seen:
            problems.append(Problem("runs", member.run, "each arm of a block once"))
        seen.add(member.run)
    if problems:
        raise InputError("dataset", problems)
