"""Gazebo program: flavour, version, and the command lines of its server and its window."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final, Literal

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
    found = _CLASSIC_ANSWER.search(text)
    return found[1] if found else None


def parse_sim_version(text: str) -> str | None:
    """The newest version in what `gz sim --versions` printed, the one that it starts; None if it printed others."""
    found = _SIM_ANSWER.fullmatch(text)
    return found[1] if found else None
