"""Do the attacks of a compromised ground station keep their contract?"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.scenario.model.scenario import Fence, FenceCircle, FencePolygon, Scenario
from skyrange.testing import check_attack
from skyrange.testing.checks.attacks import two_squares
from tests.conformance.test_attacks_telemetry import signed_squares

INSIDER = AttackPlugin.find("ground.insider")
PLAN_FILE = AttackPlugin.find("ground.plan_file")
GEO_ZONES = AttackPlugin.find("ground.geo_zones")

BLUE = {"vehicles": ["blue/b1"]}


def fenced_squares(duration_s: float) -> Scenario:
    """The two squares of the check, beside closed areas."""
    circle = FenceCircle(center=(60, 60), radius_m=20, inclusion=False)
    fence = Fence(circles=(circle,), polygons=(FencePolygon(points=((90, 0), (99, 0), (99, 9)), inclusion=False),))

    def fenced(vehicle: Any) -> Any:
        return vehicle.model_copy(update={"plan": vehicle.plan.model_copy(update={"fence": fence})})

    squares = signed_squares(duration_s)
    operators = tuple(
        one.model_copy(update={"vehicles": tuple(map(fenced, one.vehicles))}) for one in squares.operators
    )
    return squares.model_copy(update={"operators": operators})


MEETING = {"operator": "blue", "at": [30.0, 30.0, 15.0]}
KINDS: list[tuple[AttackPlugin, Mapping[str, Any], Collection[str], Callable[[float], Scenario], float, float]] = [
    (INSIDER, MEETING, {"replace", "inject"}, two_squares, 3.0, 7.0),
    (INSIDER, MEETING, {"replace", "inject"}, signed_squares, 9.0, 12.0),
    (PLAN_FILE, {**BLUE, "offset_m": [40, 0, 5]}, {"replace"}, signed_squares, 0.0, 4.0),
    (PLAN_FILE, {**BLUE, "form": "scale"}, {"replace"}, two_squares, 0.0, 4.0),
    (PLAN_FILE, {**BLUE, "form": "sea_level"}, {"replace"}, two_squares, 0.0, 4.0),
    (PLAN_FILE, {**BLUE, "form": "endless"}, {"replace"}, two_squares, 0.0, 4.0),
    (GEO_ZONES, BLUE, {"replace"}, fenced_squares, 0.0, 6.0),
    (GEO_ZONES, {**BLUE, "form": "move", "east_m": 50}, {"replace"}, fenced_squares, 0.0, 6.0),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "params", "acts", "scenario", "start_s", "stop_s"),
    KINDS,
    ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)],
)
def test_ground_attacks_conform(
    kind: AttackPlugin,
    params: Mapping[str, Any],
    acts: Collection[str],
    scenario: Callable[[float], Scenario],
    start_s: float,
    stop_s: float,
) -> None:
    check_attack(kind, params, acts=acts, scenario=scenario, start_s=start_s, stop_s=stop_s)
