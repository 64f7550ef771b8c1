"""Do the attacks on flight approval keep their contract?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from skyrange.attack.approval.forged_decision import FORGED_DECISION
from skyrange.attack.contract import AttackPlugin
from skyrange.testing import check_attack

BLUE = {"vehicles": ["blue/b1"]}
KINDS: list[tuple[AttackPlugin, Mapping[str, Any]]] = [
    (FORGED_DECISION, BLUE),
    (FORGED_DECISION, {"vehicles": ["blue/b1", "green/g1"], "decision": "Accepted"}),
]


@pytest.mark.parametrize(("kind", "params"), KINDS, ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)])
def test_approval_attacks_conform(kind: AttackPlugin, params: Mapping[str, Any]) -> None:
    check_attack(kind, params, acts={"inject"}, start_s=0.0, stop_s=4.0)
