"""Do the kinds of benign faults keep their contract, and does the check notice one that does not?"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import pytest

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Transmitter
from skyrange.fault.contract import FaultContext, FaultParts, FaultPlugin
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_text
from skyrange.testing import NonConformance, check_attack, check_fault

JUMP = AttackPlugin.find("gnss.jump")
BATTERY_FADE = FaultPlugin.find("battery.fade")
GNSS_MULTIPATH = FaultPlugin.find("gnss.multipath")
GNSS_OUTAGE = FaultPlugin.find("gnss.outage")
GUST = FaultPlugin.find("gust")
MOTOR_LOSS = FaultPlugin.find("motor.loss")
OPERATOR_ERROR = FaultPlugin.find("operator.error")
SENSOR_FAILURE = FaultPlugin.find("sensor.failure")

LINK_LOSS = FaultPlugin.find("link.loss")
LINK_OUTAGE = FaultPlugin.find("link.outage")
STATION_RESTART = FaultPlugin.find("station.restart")

ONE = {"vehicles": ["blue/b1"]}
LINK = {"links": ["gcs:blue/b1", "log:blue/*"]}
KINDS: list[tuple[FaultPlugin, Mapping[str, Any], Collection[str]]] = [
    (GNSS_OUTAGE, ONE, {"sensor"}),
    (SENSOR_FAILURE, {**ONE, "sensor": "barometer"}, {"sensor"}),
    (SENSOR_FAILURE, {"vehicles": ["blue/b1", "green/g1"], "sensor": "compass", "failure": "noisy"}, {"sensor"}),
    (BATTERY_FADE, {**ONE, "drop_v": 1.0, "rise_s": 2.0}, {"sensor"}),
    (LINK_LOSS, {**LINK, "burst_s": 0.5, "gap_s": 0.5}, {"drop"}),
    (LINK_OUTAGE, {**LINK, "direction": "rev"}, {"drop"}),
    (STATION_RESTART, {"operator": "blue", "down_s": 2.0}, {"drop"}),
    (MOTOR_LOSS, {**ONE, "loss": 0.6}, {"body"}),
    (GUST, {"speed_mps": 9.0, "length_m": 20.0, "travel_mps": 8.0, "at": [-5, 0, 0], "from_deg": 270}, {"body"}),
    (OPERATOR_ERROR, {**ONE, "command": "land"}, {"inject"}),
    (OPERATOR_ERROR, {"vehicles": ["blue/b1", "green/g1"], "command": "speed"}, {"inject"}),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "params", "acts"), KINDS, ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)]
)
def test_faults_conform(kind: FaultPlugin, params: Mapping[str, Any], acts: Collection[str]) -> None:
    check_fault(kind, params, acts=acts)


def street(duration_s: float) -> Scenario:
    """One aircraft that takes off in a street, whose frames are signed."""
    return load_text(f"""
name = "street"
seed = 7
duration_s = {duration_s}
origin = {{ lat = 40.7780, lon = -73.9550, alt_msl_m = 20 }}
[city]
grid = {{ blocks = [4, 3], height_m = [45, 90], street_m = 40, block_m = 90 }}
[[operators]]
id = "blue"
signing = "on"
  [[operators.vehicles]]
  id = "b1"
  start = [0, -200]
  placing = "clear"
  plan = {{ path = {{ points = [[0, 0], [0, 50]], alt_m = 15 }} }}
""")


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("kind", "acts"), [(GNSS_MULTIPATH, {"sensor"}), (OPERATOR_ERROR, {"inject"})], ids=["multipath", "signed"]
)
def test_faults_conform_in_a_street_with_signed_links(kind: FaultPlugin, acts: Collection[str]) -> None:
    check_fault(kind, ONE, scenario=street, acts=acts)


def test_an_attack_that_acts_on_bodies_breaks_the_contract() -> None:
    def with_gust(params: Any, given: AttackContext) -> Attack:
        made = JUMP.make(params, given)
        return replace(made, body_hooks=GUST(GUST.params.model_validate({"speed_mps": 5.0}), given).body_hooks)

    with pytest.raises(NonConformance, match="body fault"):
        check_attack(replace(JUMP, make=with_gust), {**ONE, "offset_m": [9, 0, 0]}, acts={"sensor"})


def test_a_fault_with_a_radio_breaks_the_contract() -> None:
    def with_radio(params: Any, given: FaultContext) -> FaultParts:
        return replace(LINK_OUTAGE.make(params, given), radios=[Transmitter(given.radio, (0.0, 0.0, 2.0), 10.0)])

    with pytest.raises(NonConformance, match=r"fault\.benign"):
        check_fault(replace(LINK_OUTAGE, make=with_radio), LINK, acts={"drop"})
