"""Compilation before a flight whose clock does not wait: the scenario is flown in virtual time, and discarded.

Compilation takes a minute of processor time, and processes load what another has compiled; so of a live range's
processes on a machine the first does it alone, before the others start. What the first half minute of a flight seldom
has is in a scenario of its own, `rehearsal.toml`: it takes a second, so only those nodes fly it that may need it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from skyrange.assembly.build import build
from skyrange.core.time import NS_PER_S, Time
from skyrange.kernel import Kernel
from skyrange.scenario.model.fleet import Autopilots
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_file

WARM_UP_NS: Final[Time] = 30 * NS_PER_S
"""Simulated time that is flown: most aircraft have armed, taken off and flown by then."""
REHEARSAL: Final = Path(__file__).with_name("rehearsal.toml")


def warm_up(scenario: Scenario, *, rehearse: bool = True) -> None:
    """Fly the first half minute in virtual time, unrecorded, with the builtin autopilot in place of every other.

    With `rehearse` also fly the rehearsal: evasion, return, landing, collision.
    """
    for flown in (_all_builtin(scenario), *([load_file(REHEARSAL)] if rehearse else [])):
        built = build(flown)
        try:
            Kernel(built.wiring).advance(min(built.duration_ns, WARM_UP_NS))
        finally:
            built.close()


def with_builtin_medium(scenario: Scenario) -> Scenario:
    """`scenario` with the builtin radio medium: a process without the oracle needs no other one."""
    if scenario.radio is None:
        return scenario
    radio = scenario.radio.model_copy(update={"engine": "builtin", "params": {}, "losses": "city"})
    return scenario.model_copy(update={"radio": radio})


def _all_builtin(scenario: Scenario) -> Scenario:
    """`scenario` with builtin autopilots, without parameters: the builtin does not have all those of the others."""
    operators = tuple(
        operator.model_copy(
            update={
                "vehicles": tuple(
                    vehicle.model_copy(update={"autopilot": "builtin", "params": {}})
                    if vehicle.autopilot != "builtin"
                    else vehicle
                    for vehicle in operator.vehicles
                )
            }
        )
        for operator in scenario.operators
    )
    return scenario.model_copy(update={"operators": operators, "autopilots": Autopilots()})
