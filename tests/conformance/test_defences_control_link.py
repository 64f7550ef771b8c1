"""Do the defences of control links over the air keep their contract?"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import pytest

from skyrange.scenario.model.scenario import Link, Radio, Scenario
from skyrange.testing import check_defence
from skyrange.testing.checks.attacks import two_squares

CHANGE = "control_link.channel_change"
REACTIVE = {
    "kind": "control_link.reactive_jam",
    "start_s": 5.0,
    "params": {"transmitter_m": [5.0, 5.0, 2.0], "power_dbm": 10},
}
NOISE = {
    "kind": "remote_id.jam",
    "start_s": 5.0,
    "params": {"transmitter_m": [5.0, 5.0, 2.0], "centre_mhz": 2412, "power_dbm": 30},
}
CASES: list[tuple[Mapping[str, Any], Mapping[str, Any], Collection[str]]] = [
    ({}, REACTIVE, ("channel",)),
    ({"channels": [1, 6, 11], "announcements": 1, "dwell_ms": 37}, REACTIVE, ("channel",)),
    ({}, NOISE, ("channel", "scan")),
]


def over_wifi(duration_s: float) -> Scenario:
    """Two aircraft whose control links are over Wi-Fi."""
    scenario = two_squares(duration_s)
    return scenario.model_copy(update={"radio": Radio(), "links": (Link(match="gcs:*", channel="wifi"),)})


@pytest.mark.catalogue
@pytest.mark.parametrize(("params", "attack", "acts"), CASES, ids=["reactive", "short", "noise"])
def test_kind_conforms(params: Mapping[str, Any], attack: Mapping[str, Any], acts: Collection[str]) -> None:
    check_defence(CHANGE, params, attack, scenario=over_wifi, acts=acts)


@pytest.mark.catalogue
def test_hopping_conforms() -> None:
    check_defence(CHANGE, {"hop_s": 0.7}, REACTIVE, scenario=over_wifi, acts=False, alerts=True)
