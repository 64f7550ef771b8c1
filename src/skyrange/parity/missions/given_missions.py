"""Mission files that are flown by two kinds of autopilot, each moved to the start of its aircraft."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skyrange.codec.mission import Mission, read_mission
from skyrange.core.errors import InputError, Problem
from skyrange.core.geodesy import Origin
from skyrange.gcs.plan.paths import Point
from skyrange.gcs.plan.plans import anchored


@dataclass(frozen=True, slots=True)
class GivenMission:
    """A mission file with a number, which starts at 1."""

    number: int
    file: Path
    mission: Mission

    def at(self, origin: Origin, start_enu_m: tuple[float, float]) -> Mission:
        """The mission for an aircraft that starts at `start_enu_m`, with altitudes relative to the start."""
        return anchored(self.mission, origin, Point(*start_enu_m, 0.0))

    @property
    def commands(self) -> tuple[int, ...]:
        """The commands of its items."""
        return tuple(item.command for item in self.mission.items)

    @property
    def words(self) -> str:
        """The name of the file."""
        return str(self.file)


@dataclass(frozen=True, slots=True)
class RefusedMission:
    """A mission file that is not flown, and all that is wrong with it."""

    file: Path
    reason: str

    @classmethod
    def of(cls, file: Path, problems: Sequence[Problem]) -> RefusedMission:
        """The refusal for these problems."""
        return cls(file, "; ".join(map(str, problems)))


def read_missions(files: Sequence[Path]) -> tuple[list[GivenMission], list[RefusedMission]]:
    """The missions in `.waypoints`, `.txt` and `.plan` files, and the files that cannot be read."""
    missions, refused = [], []
    for number, file in enumerate(files, start=1):
        try:
            missions.append(GivenMission(number, file, read_mission(file)))
        except InputError as error:
            refused.append(RefusedMission.of(file, error.problems))
    return missions, refused
