"""Mission files that are flown by two kinds of autopilot, each moved to the start of its aircraft."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skyrange.codec.mission import Mission, read_mission
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


def read_missions(files: Sequence[Path]) -> list[GivenMission]:
    """The missions in `.waypoints`, `.txt` and `.plan` files. Raises `InputError` for a file that cannot be read."""
    return [GivenMission(number, file, read_mission(file)) for number, file in enumerate(files, start=1)]
