"""Do the attacks against authenticated Remote ID keep their contract, among aircraft that sign?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.scenario import Scenario
from skyrange.scenario.toml_files import load_data
from skyrange.testing import check_attack
from tests.drip_range import table

SUPPRESS_PAGES = AttackPlugin.find("remote_id.suppress_pages")
SIGNED_GHOST = AttackPlugin.find("remote_id.signed_ghost")
VERIFICATION_FLOOD = AttackPlugin.find("remote_id.verification_flood")

PLACE = [10.0, 5.0, 20.0]
KINDS: list[tuple[AttackPlugin, Mapping[str, Any], bool]] = [
    (SIGNED_GHOST, {"at": PLACE, "transports": ["bt4", "wifi_beacon"]}, True),
    (SIGNED_GHOST, {"at": PLACE, "key": "unregistered"}, True),
    (SIGNED_GHOST, {"at": PLACE, "key": "stolen", "vehicle": "green/g1", "address": "vehicle"}, True),
    (VERIFICATION_FLOOD, {"transmitter_m": PLACE, "rate_hz": 50}, True),
    (SUPPRESS_PAGES, {"transmitter_m": PLACE}, False),  # its radio is no node of the medium here, so it hears nobody
]


def signing(duration_s: float) -> Scenario:
    """Green signs over Wi-Fi, red over Bluetooth 4, and blue not at all."""
    return load_data(table(duration_s))


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "params", "acts"), KINDS, ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)]
)
def test_attacks_on_signatures_conform(kind: AttackPlugin, params: Mapping[str, Any], acts: bool) -> None:
    check_attack(kind, params, scenario=signing, acts={"send"} if acts else False)
