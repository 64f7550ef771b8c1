"""Does every shipped kind of attack say what it acts on, what it needs, and what its controls are?"""

from __future__ import annotations

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.attack.techniques import ATTACK_ICS, NO_FIT, SPARTA, describe_technique
from skyrange.contracts.plugins.registry import ATTACKS, kinds

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
    assert kind.technique == NO_FIT or kind.technique in {*ATTACK_ICS, *SPARTA}
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


def test_techniques_have_names() -> None:
    assert describe_technique("T0855") == "ATT&CK for ICS T0855, Unauthorized Command Message"
    with pytest.raises(ValueError, match="T0855"):
        describe_technique("T08555")
