"""Do the attacks on links keep their contract?"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.attack.link.connection_loss import BREAK
from skyrange.attack.link.corrupt import CORRUPT
from skyrange.attack.link.delay import DELAY
from skyrange.attack.link.drop import DROP
from skyrange.attack.link.duplicate import DUPLICATE
from skyrange.attack.link.eavesdrop import EAVESDROP
from skyrange.attack.link.flood import FLOOD
from skyrange.attack.link.reorder import REORDER
from skyrange.attack.link.replay import REPLAY
from skyrange.attack.link.throttle import THROTTLE
from skyrange.testing import check_attack

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
