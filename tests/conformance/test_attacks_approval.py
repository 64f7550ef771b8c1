"""Do the attacks on flight approval keep their contract?"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.scenario.model.constraints import ConstraintTable
from skyrange.scenario.model.scenario import Operator, Origin, Scenario, Start, Vehicle, square
from skyrange.testing import check_attack

pytestmark = pytest.mark.rotating

ECLIPSE = AttackPlugin.find("approval.eclipse")
EQUIVOCATE = AttackPlugin.find("approval.equivocate")
FALSE_CONTINGENCY = AttackPlugin.find("approval.false_contingency")
FALSE_DETAILS = AttackPlugin.find("approval.false_details")
FORGED_DECISION = AttackPlugin.find("approval.forged_decision")
POISONED_CONSTRAINT = AttackPlugin.find("approval.poisoned_constraint")
SLOW_GOSSIP = AttackPlugin.find("approval.slow_gossip")
SQUAT = AttackPlugin.find("approval.squat")
STOLEN_TOKEN = AttackPlugin.find("approval.stolen_token")
SUPPRESS_NOTIFICATIONS = AttackPlugin.find("approval.suppress_notifications")

BLUE = {"vehicles": ["blue/b1"]}
CORRIDOR = {"operator": "green", "from_m": [-20, 0], "to_m": [60, 0]}
KINDS: list[tuple[AttackPlugin, Mapping[str, Any], str, str]] = [
    (FORGED_DECISION, BLUE, "approve-all", "inject"),
    (FORGED_DECISION, {"vehicles": ["blue/b1", "green/g1"], "decision": "Accepted"}, "approve-all", "inject"),
    (SQUAT, CORRIDOR, "authority", "inject"),
    (SQUAT, {**CORRIDOR, "requests": 20, "every_s": 0.05}, "approve-all", "inject"),
    (FALSE_DETAILS, {"uss": "blue"}, "federated", "replace"),
    (STOLEN_TOKEN, {"uss": "blue"}, "federated", "inject"),
    (EQUIVOCATE, CORRIDOR, "hashgraph", "inject"),
    (FALSE_CONTINGENCY, CORRIDOR, "authority", "inject"),
    (FALSE_CONTINGENCY, {**CORRIDOR, "after_s": 0.5}, "federated", "inject"),
    (POISONED_CONSTRAINT, {"from_m": [-20, 0], "to_m": [60, 0]}, "federated", "replace"),
    (SUPPRESS_NOTIFICATIONS, {"uss": "blue"}, "federated", "drop+inject"),
    (ECLIPSE, {"operator": "blue"}, "hashgraph", "drop"),
    (ECLIPSE, {"operator": "blue", "through": ["red"]}, "hashgraph", "drop"),
    (SLOW_GOSSIP, {"operator": "red", "delay_s": 0.5}, "hashgraph", "delay"),
    (SLOW_GOSSIP, {"operator": "red", "members": ["blue"]}, "hashgraph", "delay"),
]


def with_approval(approval: str, duration_s: float) -> Scenario:
    """Three aircraft of three operators near each other."""
    operators = tuple(
        Operator(
            id=name,
            approval=approval,
            vehicles=(Vehicle(id=f"{name[0]}1", start=Start(east_m=40.0 * place), plan=square(10, 8)),),
        )
        for place, name in enumerate(("blue", "green", "red"))
    )
    origin = Origin(lat=-35.363328, lon=149.1652241)
    closed = ConstraintTable(id="fire", corners_m=((200, 200), (300, 200), (300, 300)), published_s=1.0)
    constraints = (closed,) if approval == "federated" else ()
    return Scenario(
        name="checked",
        seed=7,
        duration_s=duration_s,
        origin=origin,
        operators=operators,
        constraints=constraints,
    )


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "params", "approval", "act"), KINDS, ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)]
)
def test_approval_attacks_conform(kind: AttackPlugin, params: Mapping[str, Any], approval: str, act: str) -> None:
    check_attack(
        kind, params, scenario=partial(with_approval, approval), acts=set(act.split("+")), start_s=0.0, stop_s=4.0
    )
