"""Scenarios from and to TOML: reading, overrides, named files and validation; all problems are reported at once."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from skyrange.city.building_files import load_buildings
from skyrange.core.errors import InputError, Problem
from skyrange.core.files import expand_user
from skyrange.scenario.model.manual_acts import ManualActTable
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.named_files import locate_files, read_text, rename_files
from skyrange.scenario.overrides import apply_overrides
from skyrange.scenario.validation.error_messages import explain_errors


def replace_city(data: Mapping[str, Any], file: str | Path) -> dict[str, Any]:
    """A scenario's table with the city replaced by a file of buildings and the origin moved to the middle of it.

    The heights of the old origin do not apply at the new one, so `origin.alt_msl_m` and `origin.geoid_m` become 0; set
    them if they matter. Raises InputError for an invalid file.
    """
    path = expand_user(file).absolute()
    _, middle = load_buildings(path)
    origin = {"lat": round(middle.lat_deg, 7), "lon": round(middle.lon_deg, 7)}
    return {**data, "origin": origin, "city": {"buildings": str(path)}}


MAX_DEPTH = 64
"""Tables and lists inside each other; a scenario needs nine."""
_PART = r"""(?:[A-Za-z0-9_-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+"""
_LONG_KEY = re.compile(rf"(?:^|[{{,])[ \t]*+\[{{0,2}}+[ \t]*+(?:{_PART}\.[ \t]*+){{{MAX_DEPTH}}}", re.MULTILINE)


def load_file(
    path: str | Path,
    overrides: Iterable[str] = (),
    *,
    seed: int | None = None,
    buildings: str | Path | None = None,
    who: str = "",
) -> Scenario:
    """The scenario in a TOML file.

    `buildings` replaces its city and moves its origin (`buildings.replace_city`). `overrides` are `path=value` and are
    applied next; `seed` is applied last. Raises InputError with all problems, which names `who`, by default the file.
    """
    path = Path(path)
    who = who or str(path)
    return load_text(read_text(path, who), who, path.parent, overrides=overrides, seed=seed, buildings=buildings)


def load_text(
    text: str,
    who: str = "scenario",
    folder: str | Path = ".",
    *,
    overrides: Iterable[str] = (),
    seed: int | None = None,
    buildings: str | Path | None = None,
) -> Scenario:
    """As `load_file`, from TOML text. Errors name `who`; the names of files in the text are relative to `folder`."""
    data = parse_toml(text, who)
    if "name" not in data and who.endswith(".toml"):
        data["name"] = re.sub(r"[^A-Za-z0-9]+", "-", Path(who).stem).strip("-")[:64] or "scenario"
    if buildings is not None:
        data = replace_city(data, buildings)
    overrides = list(overrides)
    data = apply_overrides(data, overrides)
    if seed is not None:
        data["seed"] = seed
    return load_data(data, f"{who} with --set" if overrides else who, folder)


def load_data(data: Mapping[str, Any], who: str = "scenario", folder: str | Path = ".") -> Scenario:
    """The scenario that plain data describes. Raises InputError with all problems, also those of named files."""
    _check_plain(data, who)
    data, problems = locate_files(data, Path(folder))
    try:
        scenario = Scenario.model_validate(data)
    except ValidationError as error:
        raise InputError(who, [*explain_errors(error, Scenario, data, Scenario.cross_check), *problems]) from None
    if problems:
        raise InputError(who, problems)
    return scenario


def parse_toml(text: str, who: str = "scenario") -> dict[str, Any]:
    """TOML text as plain data. Raises InputError with line and column."""
    long_key = _LONG_KEY.search(text)
    if long_key is not None:  # tomllib takes time with the square of the parts
        line = text.count("\n", 0, long_key.end()) + 1
        raise InputError.one(who, f"line {line}", f"a key of more than {MAX_DEPTH} parts", "a key of a scenario")
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(who, [_syntax_fault(str(error), text)]) from None
    except RecursionError:
        raise InputError.one(who, "TOML", "too many levels of nesting", "fewer levels") from None
    except ValueError as error:  # a number of thousands of digits, or a date that does not exist
        raise InputError.one(who, "TOML", str(error), "values of TOML") from None
    _check_plain(data, who)
    return data


def _check_plain(data: Mapping[str, Any], who: str) -> None:
    """Raise `InputError` for data nested too deep, and for integers that TOML does not have (64 bits)."""
    problems = []
    level: list[tuple[str, Any]] = [("", data)]
    for _ in range(MAX_DEPTH):
        below: list[tuple[str, Any]] = []
        for where, part in level:
            if isinstance(part, Mapping):
                below += [(f"{where}.{key}", value) for key, value in part.items()]
            elif isinstance(part, (list, tuple)):
                below += [(f"{where}.{index}", value) for index, value in enumerate(part)]
            elif isinstance(part, int) and not -(2**63) <= part < 2**63:
                problems.append(Problem(where[1:], f"an integer of {part.bit_length()} bits", "at most 64 bits"))
        level = below
    if level:
        problems.append(Problem(level[0][0][1:], f"nested deeper than {MAX_DEPTH}", "a scenario"))
    if problems:
        raise InputError(who, problems)


def _syntax_fault(message: str, text: str) -> Problem:
    """The place where the parser stopped, from a message with "… (at line 3, column 5)" or "… (at end of document)"."""
    problem, _, place = message.rpartition(" (at ")
    match = re.match(r"line (\d+), column (\d+)", place)
    lines = text.splitlines() or [""]
    line, column = (int(match[1]), int(match[2])) if match else (len(lines), len(lines[-1]) + 1)
    # the line is not quoted: a study may name any file of the user as its scenario
    return Problem(f"line {line}, column {column}", problem or message, "valid TOML")


def to_toml(scenario: Scenario, files: Mapping[str, str] | None = None) -> str:
    """TOML text from which `load_text` builds an equal scenario.

    `files` maps the names of files in the scenario to the names of their copies, relative to the folder of the text.
    """
    data = scenario.data()
    data["start_utc"] = data["start_utc"].astimezone(UTC)  # TOML has no offsets of seconds
    for operator in data["operators"]:
        for key in ("params", "fleets"):
            if not operator[key]:  # in a built scenario the vehicles contain them
                del operator[key]
        for vehicle in operator["vehicles"]:
            if not vehicle["params"]:
                del vehicle["params"]
    for key in ("links", "processing", "attacks", "detectors", "approvals", "hosts", "manual_acts"):
        if not data[key]:
            del data[key]
    if "radio" in data and not data["radio"]["params"]:
        del data["radio"]["params"]
    return tomli_w.dumps(rename_files(data, files) if files else data, indent=2)


def replace_manual_acts(text: str, acts: Sequence[ManualActTable]) -> str:
    """The TOML text of a scenario with other `manual_acts`."""
    return tomli_w.dumps(parse_toml(text) | {"manual_acts": [act.model_dump() for act in acts]}, indent=2)
