"""How steadily do both autopilots hover with the errors of real sensors? Each aircraft at a place of its own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.parity.flights import DEADLINE_S, compare
from skyrange.record import RunRecord, load
from skyrange.scenario.model.scenario import Scenario
from tools.agreement.gnss_reactions import HOLD

COUNT = 24
FROM_S, UNTIL_S = 50.0, 140.0
"""They stand in the air by then; the wander of GNSS takes a minute."""
_VELOCITY = ("vel_east_mps", "vel_north_mps", "vel_up_mps")
MEASURES = ("wander_m", "speed_mps", "height_m", "climb_mps", "tilt_deg")
"""RMS of the level distance from the mean place, of level speed, of height around its mean, of climb; mean tilt."""


def scenario(mission: Path, rates: str) -> Scenario:
    """Aircraft 2 km apart that hover 20 m up, in calm air, with sensors as they are unless a scenario says so.

    `rates` are ArduPilot's.
    """
    mission.write_text(HOLD.format(alt=20.0, hold=UNTIL_S))
    vehicles = [
        {
            "id": f"v{number:02d}",
            "start": [2_000.0 * number, 0.0, 0.0],
            "plan": {"file": str(mission), "anchor": "start"},
        }
        for number in range(COUNT)
    ]
    return Scenario.model_validate(
        {
            "name": "hover",
            "duration_s": UNTIL_S,
            "origin": {"lat": -35.363328, "lon": 149.1652241, "alt_msl_m": 10.0},
            "autopilots": {"deadline_s": DEADLINE_S, "options": {"ardupilot": {"rates": rates}}},
            "operators": [{"id": "blue", "vehicles": vehicles}],
        }
    )


def hovered(folder: Path, rates: str = "reduced") -> tuple[Mapping[str, float], Mapping[str, float]]:
    """Builtin and ArduPilot: the measures, means over all aircraft."""
    folder.mkdir(parents=True, exist_ok=True)
    compare(scenario(folder / "hold.waypoints", rates), folder)
    return steadiness(load(folder / "builtin")), steadiness(load(folder / "ardupilot"))


def steadiness(record: RunRecord) -> Mapping[str, float]:
    """The measures of a run, means over all aircraft."""
    table = record.table("truth", ["time_ns", "vehicle", "east_m", "north_m", "up_m", *_VELOCITY, "qx", "qy"])
    names = np.asarray(table.column("vehicle").to_pylist())
    seconds = table.column("time_ns").to_numpy() / NS_PER_S
    rows = np.stack([table.column(name).to_numpy() for name in table.column_names[2:]], axis=1).astype(np.float64)
    held = (seconds >= FROM_S) & (seconds < UNTIL_S)
    each = [_of_one(rows[held & (names == name)]) for name in sorted(set(names))]
    return dict(zip(MEASURES, np.mean(each, axis=0).tolist(), strict=True))


def _of_one(rows: NDArray[np.float64]) -> list[float]:
    away = rows[:, :3] - rows[:, :3].mean(axis=0)
    tilt = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (rows[:, 6] ** 2 + rows[:, 7] ** 2), -1.0, 1.0)))
    level, height, speed, climb = away[:, :2], away[:, 2], rows[:, 3:5], rows[:, 5]
    roots = [float(np.sqrt((part**2).sum() / len(rows))) for part in (level, speed, height, climb)]
    return [*roots, float(tilt.mean())]
