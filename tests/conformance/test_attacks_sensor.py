"""Do the attacks on sensors keep their contract?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.testing import check_attack

pytestmark = pytest.mark.rotating

ACCELEROMETER = AttackPlugin.find("sensor.accelerometer")
BAROMETER = AttackPlugin.find("sensor.barometer")
BUS = AttackPlugin.find("sensor.bus")
COMPASS = AttackPlugin.find("sensor.compass")
GYRO = AttackPlugin.find("sensor.gyro")

KINDS: list[tuple[AttackPlugin, Mapping[str, Any]]] = [
    (BAROMETER, {"offset_m": 6.0, "rise_s": 3.0}),
    (BAROMETER, {"amplitude_m": 2.0}),
    (COMPASS, {"field_gauss": [0.1, 0.0, 0.0]}),
    (GYRO, {"amplitude_dps": [200.0, 0.0, 0.0], "frequency_hz": 11.0}),
    (GYRO, {"bias_dps": [0.0, 3.0, 0.0], "rise_s": 1.0}),
    (ACCELEROMETER, {"bias_mps2": [0.0, 0.0, 2.0]}),
    (BUS, {}),
    (BUS, {"sensors": ["baro", "compass"], "bit_error_rate": 0.01}),
]


@pytest.mark.catalogue
@pytest.mark.parametrize(("kind", "params"), KINDS, ids=[f"{k.params.__name__}-{i}" for i, (k, *_) in enumerate(KINDS)])
def test_sensor_attacks_conform(kind: AttackPlugin, params: Mapping[str, Any]) -> None:
    check_attack(kind, {"vehicles": ["blue/b1"], **params}, acts={"sensor"})
