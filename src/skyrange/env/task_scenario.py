"""The scenario that the task is played on by default: a small fleet of one operator."""

from __future__ import annotations

from skyrange.core.errors import InputError
from skyrange.scenario.model.fleet import Start, Vehicle
from skyrange.scenario.model.operators import Operator
from skyrange.scenario.model.plan import square
from skyrange.scenario.model.scenario import Origin, Scenario, Wind

MAX_AIRCRAFT = 100
_APART_M = 40.0
_SIDE_M = 25.0
_ALT_M = 10.0
_DEPART_S = 4.0


def make_scenario(aircraft: int = 3, *, duration_s: float = 75.0, seed: int = 1) -> Scenario:
    """A fleet of the operator `blue`, whose aircraft (1 to 100) fly squares of 25 m side by side, 10 m high.

    Each departs at 4 s, and would land after about a minute. `duration_s` is the longest an episode lasts in simulated
    seconds. Raises `InputError` for another number of aircraft.
    """
    if isinstance(aircraft, bool) or not isinstance(aircraft, int) or not 1 <= aircraft <= MAX_AIRCRAFT:
        raise InputError.one("environment", "aircraft", aircraft, f"a whole number from 1 to {MAX_AIRCRAFT}")
    vehicles = tuple(
        Vehicle(
            id=f"b{number + 1}",
            start=Start(east_m=number * _APART_M, north_m=0.0),
            plan=square(_SIDE_M, _ALT_M),
            depart_s=_DEPART_S,
        )
        for number in range(aircraft)
    )
    return Scenario(
        name="hold-the-mission",
        seed=seed,
        duration_s=duration_s,
        origin=Origin(lat=47.3977, lon=8.5456),
        wind=Wind(speed_mps=2.0),
        operators=(Operator(id="blue", vehicles=vehicles),),
    )
