"""Wind parameters: a steady vector and an intensity of turbulence. This description needs no compiler."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skyrange.core.errors import Problem

MAX_MPS = 60.0
"""More than any wind in which a multirotor flies."""


@dataclass(frozen=True, slots=True)
class Wind:
    """Motion of the air, the same everywhere except for turbulence, which is drawn for each aircraft.

    `turbulence_mps` is the mean wind 20 ft (6 m) above the ground that causes it, W20 of MIL-F-8785C 3.7.3.4: 7.7 m/s
    is light, 15.4 moderate, 23.2 severe; 0 is none. It need not equal the steady wind.
    """

    steady_enu_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turbulence_mps: float = 0.0


CALM = Wind()


def check_wind(wind: Wind) -> list[Problem]:
    """What is wrong with the parameters."""
    problems = []
    if len(wind.steady_enu_mps) != 3 or not all(math.isfinite(part) for part in wind.steady_enu_mps):
        problems.append(Problem("wind.steady_enu_mps", repr(wind.steady_enu_mps), "three finite numbers in m/s"))
    if not 0.0 <= wind.turbulence_mps <= MAX_MPS:
        problems.append(Problem("wind.turbulence_mps", repr(wind.turbulence_mps), f"0 (none) to {MAX_MPS:g} m/s"))
    return problems
