"""Do the attacks on links keep their contract?"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.testing import check_attack

BREAK = AttackPlugin.find("link.break")
CORRUPT = AttackPlugin.find("link.corrupt")
DELAY = AttackPlugin.find("link.delay")
DROP = AttackPlugin.find("link.drop")
DUPLICATE = AttackPlugin.find("link.duplicate")
EAVESDROP = AttackPlugin.find("link.eavesdrop")
FLOOD = AttackPlugin.find("link.flood")
REORDER = AttackPlugin.find("link.reorder")
REPLAY = AttackPlugin.find("link.replay")
THROTTLE = AttackPlugin.find("link.throttle")

ONE = {"links": ["gcs:blue/b1"]}
KINDS: list[tuple[AttackPlugin, Mapping[str, Any], bool | Collection[str]]] = [
    (DROP, {"links": ["gcs:*"], "probability": 0.4}, {"drop"}),
    (DELAY, {**ONE, "delay_s": 0.3, "jitter_s": 0.2}, {"delay"}),
    (DUPLICATE, {**ONE, "copies": 2, "messages": ["HEARTBEAT", "ATTITUDE", "COMMAND_LONG"]}, {"inject"}),
    (REORDER, {**ONE, "hold_s": 0.5}, {"delay"}),
    (REPLAY, {**ONE, "record_s": 1.5, "direction": "both", "loop": True, "drop_live": True}, {"inject", "drop"}),
    (THROTTLE, {**ONE, "rate_bps": 1200, "queue_bytes": 200}, {"delay", "drop"}),
    (CORRUPT, {**ONE, "bit_error_rate": 0.002}, {"replace"}),
    (CORRUPT, {**ONE, "bit_error_rate": 0.1, "messages": ["GLOBAL_POSITION_INT"], "fix_checksum": True}, {"replace"}),
    (EAVESDROP, {"links": ["gcs:*"]}, ()),
    (FLOOD, {**ONE, "message": "PARAM_REQUEST_LIST", "rate_hz": 3}, {"inject"}),
    (FLOOD, {**ONE, "message": "COMMAND_LONG", "rate_hz": 200}, {"inject"}),
    (FLOOD, {"links": ["log:green/g1"], "towards": "station", "message": "HEARTBEAT"}, {"inject"}),
    (FLOOD, {"links": ["autopilot:*"], "message": "random", "rate_hz": 1500}, {"inject"}),
    (BREAK, {**ONE, "down_s": 0.7, "up_s": 0.4}, {"drop"}),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "params", "acts"), KINDS, ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)]
)
def test_attacks_on_links_conform(kind: AttackPlugin, params: Mapping[str, Any], acts: bool | Collection[str]) -> None:
    check_attack(kind, params, acts=acts)
