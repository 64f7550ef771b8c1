"""Do kinds that consist of one common act keep the contract of attacks?"""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.testing import check_attack
from tests.unit import test_common_acts as acts

pytestmark = pytest.mark.rotating

ON_LINK: dict[str, Any] = {"links": ["gcs:blue/b1"], "direction": "rev"}
ON_SENSORS: dict[str, Any] = {"vehicles": ["blue/b1"]}
KINDS: list[tuple[Any, dict[str, Any], str]] = [
    (acts.Drops, ON_LINK, "drop"),
    (acts.Delays, ON_LINK, "delay"),
    (acts.Duplicates, ON_LINK, "inject"),
    (acts.Climbs, ON_LINK, "replace"),
    (acts.Freezes, ON_LINK, "replace"),
    (acts.Lifts, ON_SENSORS, "sensor"),
    (acts.Sticks, ON_SENSORS, "sensor"),
]


@pytest.mark.parametrize(("kind", "params", "act"), KINDS, ids=[kind.__name__ for kind, _, _ in KINDS])
def test_kinds_of_one_act_conform(kind: Any, params: dict[str, Any], act: str) -> None:
    check_attack(kind, params, start_s=1.5, stop_s=3.0, duration_s=3.5, acts={act})
