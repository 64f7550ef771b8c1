"""Do the attacks on LiDARs and depth cameras, and the faults of their light, keep their contract?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.fault.contract import FaultPlugin
from skyrange.scenario.model.optics import OpticalSensor
from skyrange.scenario.model.scenario import Scenario
from skyrange.testing import check_attack, check_fault
from skyrange.testing.checks.attacks import two_squares

pytestmark = pytest.mark.rotating

SENSORS = (
    OpticalSensor(id="ring", model="vlp-16", azimuths=180, stabilised=True),
    OpticalSensor(id="eye", model="d435", pixels=(32, 24), rate_hz=5.0),
)
AT = {"vehicles": ["blue/b1"], "at": [25.0, 0.0, 1.0], "reach_deg": 40.0}
ATTACKS: list[tuple[str, Mapping[str, Any]]] = [
    ("lidar.relay", {**AT, "object_m": [20.0, 2.0, 1.0], "height_m": 2.0}),
    ("lidar.relay", {**AT, "object_m": [40.0, 0.0, 0.0], "height_m": 9.0, "delay_ns": 20, "generation": "randomised"}),
    ("lidar.remove", {**AT, "sensor": "ring"}),
    ("lidar.remove", {**AT, "method": "high_frequency", "generation": "fingerprint"}),
    ("lidar.blind", {**AT, "noise": 0.3}),
    ("depth.project", {**AT, "range_m": 50.0}),
]
FAULTS: list[tuple[str, Mapping[str, Any]]] = [
    ("lens.dirt", {"vehicles": ["blue/b1"], "passes": 0.7}),
    ("weather.rain", {"rain_law": "goodin"}),
    ("weather.fog", {"vehicles": ["blue/b1"], "ramp_s": 1.0}),
]


def equipped(duration_s: float) -> Scenario:
    """Two aircraft that fly squares; the first looks at the side to which it starts."""
    scenario = two_squares(duration_s)
    blue, green = scenario.operators
    start = blue.vehicles[0].start.model_copy(update={"heading_deg": 90.0})
    (one,) = (vehicle.model_copy(update={"sensors": SENSORS, "start": start}) for vehicle in blue.vehicles)
    return scenario.model_copy(update={"operators": (blue.model_copy(update={"vehicles": (one,)}), green)})


@pytest.mark.catalogue
@pytest.mark.parametrize(("kind", "params"), ATTACKS, ids=[f"{kind}-{i}" for i, (kind, _) in enumerate(ATTACKS)])
def test_attacks_on_light_conform(kind: str, params: Mapping[str, Any]) -> None:
    check_attack(AttackPlugin.find(kind), params, scenario=equipped, start_s=2.0, stop_s=5.0, acts={"scan"})


@pytest.mark.catalogue
@pytest.mark.parametrize(("kind", "params"), FAULTS, ids=[kind for kind, _ in FAULTS])
def test_faults_of_light_conform(kind: str, params: Mapping[str, Any]) -> None:
    check_fault(FaultPlugin.find(kind), params, scenario=equipped, start_s=2.0, stop_s=5.0, acts={"scan"})
