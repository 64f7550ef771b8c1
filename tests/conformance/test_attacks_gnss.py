"""Do the attacks on GNSS receivers by power and by a model of the filter keep their contract?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.testing import check_attack

CAPTURE = AttackPlugin.find("gnss.capture")
GNSS_JAM = AttackPlugin.find("gnss.jam")
MEACON = AttackPlugin.find("gnss.meacon")
PULL_OFF = AttackPlugin.find("gnss.pull_off")
GNSS_TIME = AttackPlugin.find("gnss.time")

PLACE = [60.0, 5.0, 2.0]
SENSOR = frozenset({"sensor"})
KINDS: list[tuple[AttackPlugin, Mapping[str, Any], Any]] = [
    (GNSS_JAM, {"transmitter_m": PLACE, "power_dbm": 20}, SENSOR),
    (GNSS_JAM, {"transmitter_m": PLACE, "power_dbm": -24}, SENSOR),
    (GNSS_JAM, {"transmitter_m": [90_000.0, 0.0, 2.0]}, False),
    (CAPTURE, {"transmitter_m": PLACE, "at": [20.0, 10.0, 5.0]}, SENSOR),
    (CAPTURE, {"transmitter_m": PLACE, "at": [900.0, 0.0, 5.0], "velocity_mps": [5, 0, 0], "reacquire_s": 1}, SENSOR),
    (MEACON, {"at": PLACE, "reacquire_s": 2, "isolation_db": 130}, SENSOR),
    (PULL_OFF, {"vehicles": ["blue/b1"], "bearing_deg": 30, "aligned_s": 1}, SENSOR),
    (PULL_OFF, {"vehicles": ["blue/b1"], "bearing_deg": 30, "aligned_s": 0, "distance_m": 5}, SENSOR),
    (GNSS_TIME, {"vehicles": ["blue/b1"], "offset_s": 20}, SENSOR),
    (GNSS_TIME, {"vehicles": ["blue/b1"], "offset_s": -5, "drift_s_per_s": 0.1}, SENSOR),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "params", "acts"), KINDS, ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)]
)
def test_attacks_on_gnss_conform(kind: AttackPlugin, params: Mapping[str, Any], acts: Any) -> None:
    check_attack(kind, params, acts=acts)
