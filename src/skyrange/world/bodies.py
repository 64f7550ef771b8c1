"""Initial state of a world: the aircraft in it and its wind, and their validation. It needs no compiler."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.time import Time
from skyrange.world.airframes import AIRFRAMES

if TYPE_CHECKING:
    from skyrange.city.city import City

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


@dataclass(frozen=True, slots=True)
class Body:
    """One aircraft and its position at the start.

    `up_m` is the height of its gear above the ground; above 0 it starts in the air, at rest, motors off. `heading_deg`
    is clockwise from north; `charge` is the battery's, 0 to 1.
    """

    vehicle: str
    airframe: str
    east_m: float
    north_m: float
    up_m: float = 0.0
    heading_deg: float = 0.0
    charge: float = 1.0
    present: bool = True
    """Whether it exists; if not, it is in no truth until an engine that imposes its pose says so."""
    run: int = 0
    """The run of a batch that it belongs to; bodies of different runs never meet, and each has the names of its own
    run."""
    seed: int = 0
    """Of the chance of its sensors and of the turbulence around it; the low 64 bits count."""


def check_bodies(bodies: Sequence[Body], quantum_ns: Time, wind: Wind, city: City | None) -> None:
    """Raise one `InputError` with all problems of a world's arguments."""
    problems = []
    seen: set[tuple[int, str]] = set()
    last = 0
    for body in bodies:
        if (body.run, body.vehicle) in seen:
            problems.append(Problem(f"{body.vehicle}.vehicle", repr(body.vehicle), "an id not used by another vehicle"))
        seen.add((body.run, body.vehicle))
        allowed = (last, last + 1) if len(seen) > 1 else (0,)
        if body.run not in allowed:
            expected = " or ".join(map(str, allowed))
            hint = "Number the runs from 0 without a gap, and put the bodies of a run side by side."
            problems.append(Problem(f"{body.vehicle}.run", repr(body.run), expected, hint))
        last = body.run
        if body.airframe not in AIRFRAMES:
            problems.append(
                Problem(
                    f"{body.vehicle}.airframe",
                    repr(body.airframe),
                    "a known airframe",
                    nearest(body.airframe, AIRFRAMES),
                )
            )
        for name in ("east_m", "north_m", "up_m", "heading_deg"):
            value = getattr(body, name)
            if not math.isfinite(value):
                problems.append(Problem(f"{body.vehicle}.{name}", repr(value), "a finite number"))
        if not 0.0 <= body.charge <= 1.0:
            problems.append(Problem(f"{body.vehicle}.charge", repr(body.charge), "0 (empty) to 1 (full)"))
        if body.up_m < 0.0:
            problems.append(Problem(f"{body.vehicle}.up_m", repr(body.up_m), "0 (on the ground) or more metres"))
        place = (body.east_m, body.north_m, body.up_m)
        building = city.inside(*place) if city is not None and all(map(math.isfinite, place)) else None
        if building is not None:
            problems.append(
                Problem(body.vehicle, f"{place} m", f"a place outside buildings; {building.id} stands there")
            )
    if not bodies:
        problems.append(Problem("bodies", "none", "at least one aircraft"))
    if quantum_ns <= 0:
        problems.append(Problem("quantum_ns", repr(quantum_ns), "a positive number of nanoseconds"))
    problems += check_wind(wind)
    if problems:
        raise InputError("world", problems)
