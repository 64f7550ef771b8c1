"""Does every shipped kind of attack say what it acts on, what it needs, and what its controls are?"""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.attack.techniques import (
    ATTACK_ICS,
    NO_FIT,
    SPARTA,
    TechniqueBy,
    choose_technique,
    describe_technique,
    list_techniques,
)
from skyrange.contracts.plugins.registry import ATTACKS, kinds
from skyrange.scenario import AttackTable
from skyrange.testing.checks.attacks import Flight, SharedScenario, fly_nominal, two_squares

SHIPPED = [
    name
    for name in kinds(ATTACKS)
    if AttackPlugin.find(name).params.__module__.split(".")[:2] == ["skyrange", "attack"]
]


@pytest.mark.parametrize("name", SHIPPED)
def test_a_kind_is_described_whole(name: str) -> None:
    kind = AttackPlugin.find(name)
    assert kind.surface, "no surface"
    assert kind.effect, "no effect"
    assert not kind.effect.endswith("."), "the effect is a phrase"
    assert {*list_techniques(kind.technique)} <= {NO_FIT, *ATTACK_ICS, *SPARTA}
    if isinstance(kind.technique, TechniqueBy):
        schema = kind.params.model_json_schema()["properties"][kind.technique.parameter]
        assert schema["enum"] == list(kind.technique.techniques), "a value without a technique"
    if kind.mechanism:
        assert kind.mechanism in SHIPPED
        assert not AttackPlugin.find(kind.mechanism).mechanism
    assert kind.threat is not None, "no threat model"
    assert kind.controls is not None, "no controls"
    said = [*(getattr(kind.threat, one) for one in ("knowledge", "position", "equipment", "budget"))]
    said += [*(getattr(kind.controls, one) for one in ("load", "content", "placement"))]
    assert all(said), "an empty phrase"
    assert all(how.split(":")[0] in ("simulated", "cited", "assumed") for how in kind.realism.values())


def test_a_kind_that_alters_readings_alone_is_compared_with_the_nominal_run() -> None:
    sensors = {"gnss", "baro", "compass", "gyro", "accel"}
    silent = [name for name in SHIPPED if set(AttackPlugin.find(name).surface) <= sensors]
    assert "gnss.drift" in silent
    lying = {name for name in silent if AttackPlugin.find(name).counterfactual == "sham"}
    assert lying == {"gnss.capture", "gnss.meacon"}, "their shams lose the fix as they do, and report the truth then"


def test_kinds_differ_in_effect() -> None:
    effects = [AttackPlugin.find(name).effect for name in SHIPPED]
    assert len(set(effects)) == len(effects)


def test_a_technique_follows_from_the_direction() -> None:
    drop, station = AttackPlugin.find("link.drop"), AttackPlugin.find("identity.silence_station")
    assert choose_technique(drop.technique, {"direction": "rev"}) == "T0804"
    assert choose_technique(station.technique, {"towards": "aircraft"}) == "T0803"
    assert describe_technique(station.technique) == (
        "by towards: ATT&CK for ICS T0803, Block Command Message (aircraft); "
        "ATT&CK for ICS T0804, Block Reporting Message (station)"
    )


def test_silenced_heartbeats_are_dropped_frames() -> None:
    """The kinds of one mechanism do the same: two attacks, one run."""

    def fly(kind: str, params: dict[str, Any]) -> Flight:
        attack = AttackTable(id="a", kind=kind, start_s=2.0, params={"links": ["gcs:blue/b1"], **params})
        return fly_nominal(SharedScenario(two_squares(8.0).model_copy(update={"attacks": (attack,)})))

    one = fly("identity.silence_station", {"towards": "aircraft"})
    other = fly("link.drop", {"messages": ["HEARTBEAT"], "direction": "fwd"})
    assert len(one.labels()) > 3
    assert one.frames() == other.frames()


def test_techniques_have_names() -> None:
    assert describe_technique("T0855") == "ATT&CK for ICS T0855, Unauthorized Command Message"
    with pytest.raises(ValueError, match="T0855"):
        describe_technique("T08555")
