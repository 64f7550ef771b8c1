"""Do the attacks on control links over the air keep their contract?"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.core.errors import InputError
from skyrange.scenario.model.scenario import Link, Radio, Scenario
from skyrange.testing import check_attack
from skyrange.testing.checks.attacks import two_squares

DEAUTHENTICATE = AttackPlugin.find("control_link.deauthenticate")
REACTIVE_JAM = AttackPlugin.find("control_link.reactive_jam")

COMMAND = AttackPlugin.find("mavlink.command")
EAVESDROP = AttackPlugin.find("link.eavesdrop")
FLOOD = AttackPlugin.find("link.flood")
REPLAY = AttackPlugin.find("link.replay")

NEAR = {"transmitter_m": [5.0, 5.0, 2.0]}
IN_AIR = {"place": "air", "radio_m": [5.0, 5.0, 2.0], "has_key": True}
REQUEST = {"vehicles": ["blue/b1"], "command": "REQUEST_MESSAGE", "times": 0}
KINDS: list[tuple[AttackPlugin, Mapping[str, Any], bool | Collection[str]]] = [
    (DEAUTHENTICATE, NEAR, {"send"}),
    (DEAUTHENTICATE, {**NEAR, "links": ["gcs:blue/b1"], "towards": "aircraft", "period_ms": 37}, {"send"}),
    (REACTIVE_JAM, NEAR, {"send"}),
    (REACTIVE_JAM, {**NEAR, "links": ["gcs:green/*"], "turnaround_us": 200}, {"send"}),
    (COMMAND, {**REQUEST, **IN_AIR}, {"inject"}),
    (COMMAND, {**REQUEST, "place": "onboard"}, {"inject"}),
    (EAVESDROP, {"links": ["gcs:*"], **IN_AIR}, False),
    (FLOOD, {"links": ["gcs:*"], "rate_hz": 400, **IN_AIR}, {"inject"}),
    (REPLAY, {"links": ["gcs:blue/b1"], "record_s": 4, **IN_AIR}, {"inject"}),
]


def over_wifi(duration_s: float) -> Scenario:
    """Two aircraft whose control links are over Wi-Fi."""
    scenario = two_squares(duration_s)
    return scenario.model_copy(update={"radio": Radio(), "links": (Link(match="gcs:*", channel="wifi"),)})


@pytest.mark.catalogue
@pytest.mark.parametrize(("kind", "params", "acts"), KINDS)
def test_kind_conforms(kind: AttackPlugin, params: Mapping[str, Any], acts: bool | Collection[str]) -> None:
    check_attack(kind, params, scenario=over_wifi, acts=acts)


@pytest.mark.parametrize("kind", [DEAUTHENTICATE, REACTIVE_JAM])
def test_links_must_be_over_wifi(kind: AttackPlugin) -> None:
    with pytest.raises(InputError, match=r"gcs:\*.*control link over Wi-Fi.*channel = \"wifi\""):
        check_attack(kind, NEAR)
