"""What do the attacks on barometer, compass, gyroscopes and accelerometers add to readings?"""

from __future__ import annotations

import copy
from dataclasses import fields
from math import pi, radians, sin
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from skyrange.attack.bases.sensors import OnSensors
from skyrange.attack.contract import AttackPlugin
from skyrange.attack.declaration import attack
from skyrange.contracts.components import SensorAct, SensorHook, Sensors
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.scenario.shipped import load
from skyrange.world.sensing.sensor_errors import GYRO_FLOOR_RADPS, GYRO_MOTORS_RADPS
from tests.registered_kinds import registered
from tests.unit.test_attack_gnss import context, readings

ACCELEROMETER = AttackPlugin.find("sensor.accelerometer")
BAROMETER = AttackPlugin.find("sensor.barometer")
COMPASS = AttackPlugin.find("sensor.compass")
GYRO = AttackPlugin.find("sensor.gyro")

S, MS = NS_PER_S, NS_PER_MS
ONE: list[tuple[AttackPlugin, str, dict[str, Any]]] = [
    (BAROMETER, "baro_up_m", {"offset_m": 5.0}),
    (COMPASS, "compass_gauss", {"field_gauss": [0.1, 0.0, -0.2]}),
    (GYRO, "gyro_radps", {"bias_dps": [1.0, 2.0, 3.0]}),
    (ACCELEROMETER, "accel_mps2", {"bias_mps2": [0.0, 0.0, 1.5]}),
]


def fault(kind: AttackPlugin, sham: bool = False, **params: Any) -> SensorHook:
    chosen = kind.params.model_validate({"vehicles": ["blue/b1", "blue/b2"], **params})
    (only,) = kind(chosen, context(sham=sham)).sensor_hooks
    return only


def told(which: SensorHook, now: Time) -> Sensors:
    sensors = readings()
    which.on_sensors(now, sensors)
    return sensors


@pytest.mark.parametrize(("kind", "column", "params"), ONE, ids=[column for _, column, _ in ONE])
def test_one_sensor_is_altered_and_a_sham_alters_none(kind: AttackPlugin, column: str, params: dict[str, Any]) -> None:
    live, sham = fault(kind, **params), fault(kind, sham=True, **params)
    true, mine, other = readings(), readings(), readings()
    assert live.on_sensors(2 * S - 1, readings()) == []
    acts = live.on_sensors(2 * S, mine)
    assert acts == sham.on_sensors(2 * S, other)
    sensor = {"baro_up_m": "baro", "compass_gauss": "compass", "gyro_radps": "gyro", "accel_mps2": "accel"}[column]
    assert acts == [SensorAct("blue/b1", sensor), SensorAct("blue/b2", sensor)]
    for one in fields(Sensors):
        want = getattr(true, one.name).tobytes()
        assert getattr(other, one.name).tobytes() == want
        assert (getattr(mine, one.name).tobytes() == want) == (one.name != column)
    assert live.on_sensors(3 * S, readings()) == []


def test_an_error_rises_and_stays() -> None:
    pump = fault(BAROMETER, offset_m=12.0, rise_s=20.0)
    errors = [float((told(pump, 2 * S + s * S).baro_up_m - readings().baro_up_m)[0]) for s in (0, 5, 20, 60)]
    assert errors == pytest.approx([0.0, 3.0, 12.0, 12.0])


def test_a_slow_sensor_keeps_the_error_of_its_reading() -> None:
    pump = fault(BAROMETER, offset_m=10.0, rise_s=1.0)
    errors = [float((told(pump, 2 * S + ms * MS).baro_up_m - readings().baro_up_m)[0]) for ms in (10, 50, 90, 110)]
    assert errors == pytest.approx([0.1, 0.1, 0.1, 1.1])
    later = readings()
    later.baro_up_m += 1.0
    before = later.baro_up_m.copy()
    pump.on_sensors(2 * S + 150 * MS, later)
    assert later.baro_up_m - before == pytest.approx([1.5, 1.5]), "another reading, another error"


def test_sound_is_a_sinusoid_in_rad_per_s() -> None:
    sound = fault(GYRO, amplitude_dps=[100.0, 0.0, 0.0], frequency_hz=3.0)
    for ms in (0, 50, 83, 400):
        added = told(sound, 2 * S + ms * MS).gyro_radps - readings().gyro_radps
        want = radians(100.0) * sin(2.0 * pi * 3.0 * ms / 1e3)
        assert added == pytest.approx(np.tile([want, 0.0, 0.0], (2, 1)), abs=1e-9)


def test_it_is_plain_state() -> None:
    magnet = fault(COMPASS, field_gauss=[0.1, 0, 0], rise_s=4.0)
    told(magnet, 3 * S)
    twin = copy.deepcopy(magnet)
    assert told(twin, 5 * S).compass_gauss.tobytes() == told(magnet, 5 * S).compass_gauss.tobytes()


@pytest.mark.parametrize(
    ("kind", "params", "words"),
    [
        (BAROMETER, {}, "offset_m, amplitude_m other than zero"),
        (GYRO, {"bias_dps": [0, 0, 3000]}, "each component from -2000 to 2000 deg/s"),
        (ACCELEROMETER, {"bias_mps2": [0, 0, 200]}, "from -160 to 160"),
        (COMPASS, {"field_gauss": [0, 0, 11]}, "from -10 to 10 gauss"),
        (BAROMETER, {"offset_m": float("nan")}, "offset_m"),
    ],
)
def test_impossible_parameters_are_refused(kind: AttackPlugin, params: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        fault(kind, **params)


def test_a_stranger_is_named() -> None:
    with pytest.raises(InputError, match="blue/b4"):
        fault(BAROMETER, vehicles=["blue/b4"], offset_m=1.0)


class Stuck(OnSensors):
    """Freezes the barometer."""

    held: Any = None

    def act(self, now: Time, sensors: Sensors) -> None:
        if self.held is None:
            self.held = sensors.baro_up_m.copy()
        sensors.baro_up_m[:] = self.held


def test_a_kind_of_one_method_has_vehicles_labels_and_a_sham() -> None:
    with registered():
        kind = attack("test.stuck", surface=("baro",))(Stuck).plugin
    assert list(kind.params.model_fields) == ["vehicles"]
    for sham in (False, True):
        stuck, later = fault(kind, sham=sham), readings()
        assert stuck.name == "x.baro"
        assert stuck.on_sensors(2 * S, readings()) == [SensorAct("blue/b1", "baro"), SensorAct("blue/b2", "baro")]
        later.baro_up_m += 1.0
        stuck.on_sensors(3 * S, later)
        assert (later.baro_up_m.tobytes() == readings().baro_up_m.tobytes()) is not sham


def test_a_kind_that_does_not_say_which_sensor_it_alters_is_named() -> None:
    with registered():
        kind = attack("test.stuck")(Stuck).plugin
    with pytest.raises(InputError, match=r"class Stuck in .*surface: missing"):
        fault(kind)


def test_the_example_of_the_gyroscopes_has_dozens_of_times_their_noise_as_its_source_measured() -> None:
    """Son et al., Rocking drones (USENIX Security 2015): the standard deviation is dozens of times the usual one."""
    (sound,) = load("sensor.gyro").attacks
    deviation = radians(max(sound.params["amplitude_dps"])) / 2.0**0.5
    at_half_throttle = GYRO_FLOOR_RADPS + 0.5 * GYRO_MOTORS_RADPS
    assert 24.0 < deviation / at_half_throttle < 100.0
