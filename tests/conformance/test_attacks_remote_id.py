"""Do the attacks on the channels of Remote ID keep their contract?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.testing import check_attack

SWEEP_JAM = AttackPlugin.find("remote_id.sweep_jam")
FLOOD = AttackPlugin.find("remote_id.flood")

PLACE = [10.0, 5.0, 20.0]
KINDS: list[tuple[AttackPlugin, Mapping[str, Any]]] = [
    (FLOOD, {"transmitter_m": PLACE, "stations": 2, "rate_hz": 100}),
    (SWEEP_JAM, {"transmitter_m": PLACE, "dwell_ms": 7}),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(("kind", "params"), KINDS, ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)])
def test_attacks_on_channels_conform(kind: AttackPlugin, params: Mapping[str, Any]) -> None:
    check_attack(kind, params, acts={"send"})
