"""How is nothing compiled in flight where the clock does not wait? The scenario is flown beforehand, and thrown away.

Compiling takes a minute of processor time, and what one process compiled the others only load; so of a live range's
processes on a machine the first does it alone, before the others start. What a first half minute seldom has is in a
scenario of its own, `rehearsal.toml`: it takes a second, so only those fly it who would need it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from skyrange.core.time import NS_PER_S, Time
from skyrange.kernel import Kernel
from skyrange.scenario.autopilots import Autopilots
from skyrange.scenario.load import load_file
from skyrange.scenario.schema import Scenario
from skyrange.scenario.wire import wire

WARM_UP_NS: Final[Time] = 30 * NS_PER_S
"""Of simulated time: by then most have armed, taken off and flown."""
REHEARSAL: Final = Path(__file__).with_name("rehearsal.toml")


def warm_up(scenario: Scenario, *, rehearse: bool = True) -> None:
    """Fly the first half minute in virtual time, unrecorded, with the builtin in every other autopilot's place.

    With `rehearse` also the rehearsal: evasion, return, landing, collision.
    """
    for flown in (_all_builtin(scenario), *([load_file(REHEARSAL)] if rehearse else [])):
        rig = wire(flown)
        Kernel(rig.wiring).advance(min(rig.duration_ns, WARM_UP_NS))


def _all_builtin(scenario: Scenario) -> Scenario:
    """Without parameters too: the builtin does not have all of the others', and nobody looks where it flies."""
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
