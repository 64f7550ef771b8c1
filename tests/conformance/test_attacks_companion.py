"""Do the attacks of a compromised companion computer keep their contract?"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.scenario.model.radio import Avoidance
from skyrange.scenario.model.scenario import Operator, Origin, Plan, Radio, Scenario, Start, Vehicle
from skyrange.testing import check_attack
from skyrange.testing.checks.attacks import two_squares
from tests.conformance.test_attacks_telemetry import signed_squares

FALSE_AVOIDANCE = AttackPlugin.find("companion.false_avoidance")
NO_AVOIDANCE = AttackPlugin.find("companion.no_avoidance")
TAKEOVER = AttackPlugin.find("companion.takeover")


def encounter(duration_s: float) -> Scenario:
    """Two aircraft that fly towards each other, and avoid each other at about 19 s."""
    operators = tuple(
        Operator(
            id=name,
            avoidance=Avoidance(kind="geometric"),
            signing="on",
            vehicles=(
                Vehicle(
                    id=name[0] + "1",
                    start=Start(east_m=east_m),
                    plan=Plan.model_validate({"path": {"points": [[0, 0], [-2 * east_m, 0]], "alt_m": 20}}),
                ),
            ),
        )
        for name, east_m in (("blue", -60.0), ("green", 60.0))
    )
    return Scenario(
        name="encounter", seed=1, duration_s=duration_s, origin=Origin(lat=40.778, lon=-73.955), operators=operators,
        radio=Radio(),
    )  # fmt: skip


BLUE = {"vehicles": ["blue/b1"]}
KINDS: list[tuple[AttackPlugin, Mapping[str, Any], Collection[str], Callable[[float], Scenario], float, float]] = [
    (TAKEOVER, {**BLUE, "track": [[60, 0, 10]]}, {"replace", "inject"}, two_squares, 0.5, 7.0),
    (TAKEOVER, {**BLUE, "track": [[60, 0, 10]]}, {"inject"}, signed_squares, 9.0, 12.0),
    (FALSE_AVOIDANCE, {**BLUE, "every_s": 4, "hold_s": 2}, {"inject"}, signed_squares, 9.0, 14.0),
    (NO_AVOIDANCE, BLUE, {"replace"}, encounter, 15.0, 24.0),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "params", "acts", "scenario", "start_s", "stop_s"),
    KINDS,
    ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)],
)
def test_companion_attacks_conform(
    kind: AttackPlugin,
    params: Mapping[str, Any],
    acts: Collection[str],
    scenario: Callable[[float], Scenario],
    start_s: float,
    stop_s: float,
) -> None:
    check_attack(kind, params, acts=acts, scenario=scenario, start_s=start_s, stop_s=stop_s)
