"""Gazebo program: its search, its flavour and version, and the command lines of its server and its window.

It is found by variable or on PATH, recognised by what the program answers and not by its name.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Final, Literal

from skyrange.core.errors import ComponentError, InputError, Problem
from skyrange.core.files import expand_user
from skyrange.io.processes.program import run_once

DEFAULT_PORT: Final = 11_345
"""Port of Gazebo 11's master that a `gzserver` without other settings listens on."""

OLDEST: Final = {"classic": 11, "sim": 8}
"""Oldest supported major version of each flavour. Gazebo keeps its binary interface within a major version."""

Source = Literal["SKYRANGE_GAZEBO", "PATH", "--prefix"]

_CLASSIC_ANSWER: Final = re.compile(r"^Gazebo multi-robot simulator, version (\d+(?:\.\d+)+\S*)", re.MULTILINE)
_SIM_ANSWER: Final = re.compile(r"\s*(\d+\.\d+\.\d+\S*)(?:\s+\d+\.\d+\.\d+\S*)*\s*")
_VERBOSITY: Final = 2
"""Errors and warnings."""


class Flavour(StrEnum):
    """Which of the two simulators named Gazebo it is."""

    SIM = "sim"
    """Gazebo Sim, Harmonic or newer: the program `gz sim`."""
    CLASSIC = "classic"
    """Gazebo 11, also called Gazebo Classic: the programs `gzserver` and `gzclient`."""


@dataclass(frozen=True, slots=True)
class Gazebo:
    """An installed Gazebo: `path` is `gz`, `gzserver`, or a wrapper of one; `version` is as the program states it."""

    flavour: Flavour
    version: str
    path: Path
    source: Source = "PATH"

    @property
    def major(self) -> int:
        """The first number of the version."""
        return int(self.version.partition(".")[0])

    @property
    def title(self) -> str:
        """Name and version ("Gazebo Sim 8.9.0", "Gazebo 11.1.0")."""
        return f"Gazebo {'Sim ' if self.flavour == Flavour.SIM else ''}{self.version}"

    @property
    def build(self) -> str:
        """Name of the interface that a plugin is compiled for: flavour and major version ("sim8", "classic11")."""
        return f"{self.flavour}{self.major}"

    def server_command(self, world: Path, *, seed: int | None = None, port: int = DEFAULT_PORT) -> tuple[str, ...]:
        """Command line that simulates the SDF file `world` without a window, and runs at once.

        `seed` (0 or larger) sets Gazebo's random numbers. Servers with different values of `port` do not hear each
        other: it is the TCP port of Gazebo 11's master, and part of the name of Gazebo Sim's partition.
        """
        options = () if seed is None else ("--seed", str(seed))
        start = ("--verbose",) if self.flavour == Flavour.CLASSIC else ("sim", "-s", "-r", "-v", str(_VERBOSITY))
        return (*isolate(port), str(self.path), *start, *options, str(world.absolute()))


def isolate(port: int) -> tuple[str, ...]:
    """Begin of a command line: a Gazebo that talks on this machine alone, with those of the same `port` only.

    Without a database of models Gazebo 11 does not reach for the network when it starts.
    """
    return (
        "env",
        f"GAZEBO_MASTER_URI=http://127.0.0.1:{port}",
        "GAZEBO_IP=127.0.0.1",
        "GAZEBO_MODEL_DATABASE_URI=",
        *(f"{old_or_new}_PARTITION=skyrange-{port}" for old_or_new in ("GZ", "IGN")),
        *(f"{old_or_new}_IP=127.0.0.1" for old_or_new in ("GZ", "IGN")),
    )


def parse_classic_version(text: str) -> str | None:
    """The version in what `gzserver --version` printed; None if it is not Gazebo 11 or its predecessors."""
    match = _CLASSIC_ANSWER.search(text)
    return match[1] if match else None


def parse_sim_version(text: str) -> str | None:
    """The newest version in what `gz sim --versions` printed, the one that it starts; None if it printed others."""
    match = _SIM_ANSWER.fullmatch(text)
    return match[1] if match else None


VARIABLE: Final = "SKYRANGE_GAZEBO"
"""Environment variable with the path of `gz`, `gzserver`, or a wrapper of one; it precedes PATH."""
WINDOW_VARIABLE: Final = "SKYRANGE_GZCLIENT"
"""Environment variable with the path of `gzclient`, or a wrapper of it, the window of Gazebo 11."""
ANSWER_S: Final = 20.0
"""Wall time within which a program must tell its version; `gz` starts Ruby, on a busy machine in seconds."""
EXPECTED: Final = f"Gazebo Sim {OLDEST['sim']} (Harmonic) or newer, or Gazebo {OLDEST['classic']}"
HOW_TO_GET: Final = (
    "On Ubuntu or Debian with the packages of gazebosim.org: sudo apt-get install gz-harmonic; "
    "on Debian 11 or Ubuntu 22.04: sudo apt-get install gazebo libgazebo-dev. "
    f"For one elsewhere set {VARIABLE} to the path of its gz or gzserver"
)
_NO_COMMANDS: Final = "cannot find any available 'gz' command"
"""What `gz` says whose folder of commands is not where it was compiled to be."""
_MOVED: Final = "Move Gazebo to the folder that it was built for, its CMAKE_INSTALL_PREFIX, or build it for this one"

_seen: dict[tuple[str, int, int], Gazebo] = {}
"""Programs that have told their version, by path, size and time of change."""


def find_gazebo() -> Gazebo:
    """The Gazebo to use: that of the variable SKYRANGE_GAZEBO, else `gz` on PATH, else `gzserver` on PATH.

    `gz` on PATH is passed over for `gzserver` if it has no Gazebo Sim, or none that is supported.

    Raises `InputError` if the named one is unsuitable, or if none on PATH is suitable.
    """
    named = os.environ.get(VARIABLE)
    if named:
        return examine_gazebo(expand_user(named), VARIABLE)
    problems: list[Problem] = []
    for name in ("gz", "gzserver"):
        program = shutil.which(name)
        if program is not None:
            try:
                return examine_gazebo(Path(program), "PATH")
            except InputError as error:
                problems += error.problems
    if problems:
        raise InputError("Gazebo on PATH", problems)
    where = f"{VARIABLE} (not set) and PATH"
    raise InputError.one("Gazebo", where, "neither gz nor gzserver", EXPECTED, HOW_TO_GET)


def examine_gazebo(path: Path, source: Source) -> Gazebo:
    """Ask the program `path` for its version; an answer is kept while the file is unchanged.

    Raises `InputError`, naming the source of the path, if it is no program, does not answer in time, or is no supported
    Gazebo.
    """
    who = "Gazebo on PATH" if source == "PATH" else source
    path = path.absolute()
    where = str(path)
    try:
        facts = path.stat()
    except (OSError, ValueError) as error:  # ValueError: a NUL
        problem = (getattr(error, "strerror", None) or str(error)).lower()
        raise InputError.one(who, where, problem, EXPECTED, HOW_TO_GET) from None
    if path.is_dir():
        hint = "Give the path of the file gz or gzserver in that folder"
        raise InputError.one(who, where, "a folder", "the program gz or gzserver itself", hint)
    if not os.access(path, os.X_OK):
        hint = f"Make it executable: chmod +x {shlex.quote(where)}"
        raise InputError.one(who, where, "a file that is not executable", "a program", hint)
    key = (where, facts.st_size, facts.st_mtime_ns)
    if key not in _seen:
        _seen[key] = _ask(path, who)
    return replace(_seen[key], source=source)


def _ask(path: Path, who: str) -> Gazebo:
    """The Gazebo that `path` is. `--version` comes first: a `gzserver` asked for `sim --versions` starts to serve."""
    where = str(path)
    text = _answer(path, who, "--version")
    flavour, version = Flavour.CLASSIC, parse_classic_version(text)
    if version is None:
        text = _answer(path, who, "sim", "--versions")
        flavour, version = Flavour.SIM, parse_sim_version(text)
    if version is None:
        if _NO_COMMANDS in text:
            value = "gz without any command: it looks for them in the folder that it was built for"
            raise InputError.one(who, where, value, EXPECTED, _MOVED)
        if "'gz' command" in text:
            raise InputError.one(who, where, "gz without the command sim", EXPECTED, HOW_TO_GET)
        if "Invalid arguments" in text:
            hint = f"Set {VARIABLE} to the path of gzserver"
            raise InputError.one(who, where, "the program gz of Gazebo 11 or older, not its gzserver", EXPECTED, hint)
        answer = next((line.strip() for line in text.splitlines() if line.strip()), "")
        value = f"answers `sim --versions` with {answer[:100]!r}" if answer else "says nothing of its version"
        raise InputError.one(who, where, value, EXPECTED, HOW_TO_GET)
    gazebo = Gazebo(flavour, version, path)
    if gazebo.major < OLDEST[flavour]:
        raise InputError.one(who, where, gazebo.title, EXPECTED, HOW_TO_GET)
    return gazebo


def _answer(path: Path, who: str, *arguments: str) -> str:
    """What a program prints. Its exit status tells nothing: `gzserver --version` ends with 255."""
    try:
        return run_once(path, *arguments, deadline_s=ANSWER_S).text
    except ComponentError as error:
        problem = str(error).removeprefix(f"{path}: ")
        hint = f"Try `{shlex.join([str(path), *arguments])}`"
        raise InputError.one(who, str(path), problem, "an answer with its version", hint) from None


def window_command(gazebo: Gazebo, port: int) -> tuple[str, ...]:
    """Command line of Gazebo's window onto the server that was started with `port`.

    That of Gazebo 11 is the program `gzclient`: of the variable SKYRANGE_GZCLIENT, beside `gzserver`, or on PATH.
    Raises `InputError` if it is missing.
    """
    if gazebo.flavour == Flavour.SIM:
        return (*isolate(port), str(gazebo.path), "sim", "-g")
    named = os.environ.get(WINDOW_VARIABLE)
    if named:
        program = expand_user(named)
        if not os.access(program, os.X_OK) or program.is_dir():
            raise InputError.one(WINDOW_VARIABLE, "path", named, "an executable file, gzclient of Gazebo 11")
        return (*isolate(port), str(program.absolute()))
    beside = gazebo.path.with_name("gzclient")
    window_program = str(beside) if os.access(beside, os.X_OK) else shutil.which("gzclient")
    if window_program is None:
        hint = f"On Debian 11: sudo apt-get install gazebo. For one elsewhere set {WINDOW_VARIABLE}"
        raise InputError.one("Gazebo", f"{gazebo.path.parent} and PATH", "no gzclient", "the window of Gazebo 11", hint)
    return (*isolate(port), window_program)


def find_window(gazebo: Gazebo) -> str:
    """The program of the window: `gzclient`, or `gz` with its command `gui`. Raises `InputError` without one."""
    program = window_command(gazebo, 0)[len(isolate(0))]
    if gazebo.flavour == Flavour.SIM and "gui" not in _answer(gazebo.path, "Gazebo", "--commands").split():
        hint = "On Ubuntu or Debian: sudo apt-get install gz-harmonic"
        raise InputError.one("Gazebo", str(gazebo.path), "gz without the command gui", "Gazebo with a window", hint)
    return program
