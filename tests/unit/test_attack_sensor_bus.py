"""What does a bus whose bits flip tell a flight controller?"""

from __future__ import annotations

import copy
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from skyrange.attack.contract import AttackPlugin
from skyrange.attack.sensor.bus import ACCELEROMETER, GYRO, Register, flip_height
from skyrange.contracts.components import SensorAct, SensorHook, Sensors
from skyrange.core.time import NS_PER_MS, NS_PER_S
from tests.unit.test_attack_gnss import context, readings

BUS = AttackPlugin.find("sensor.bus")
S, MS = NS_PER_S, NS_PER_MS
COLUMNS = {"gyro": "gyro_radps", "accel": "accel_mps2", "compass": "compass_gauss", "baro": "baro_up_m"}


def hook(sham: bool = False, **params: Any) -> SensorHook:
    chosen = BUS.params.model_validate({"vehicles": ["blue/b1", "blue/b2"], **params})
    (only,) = BUS(chosen, context(sham=sham)).sensor_hooks
    return only


def told(which: SensorHook, now: int) -> Sensors:
    sensors = readings()
    which.on_sensors(now, sensors)
    return sensors


def test_words_are_registers_and_a_word_without_a_flip_is_exact() -> None:
    register = Register(16, 32.768)  # a thousandth for each step
    values = np.array([1.2345678, 1.0, -1.0, 0.0, 99.0])
    assert register.flip(values, np.zeros(5, dtype=np.int64)).tolist() == values.tolist()
    masks = np.array([1, 0x8000, 0x8000, 0xFFFF, 1], dtype=np.int64)
    expected = [1.234, 1.0 - 32.768, -1.0 + 32.768, -0.001, 32.766]
    assert register.flip(values, masks) == pytest.approx(expected, abs=1e-9), "one step, the sign, all bits, full scale"
    assert GYRO.flip(np.zeros(1), np.array([0x8000])) == pytest.approx(-np.radians(2000.0))
    assert ACCELEROMETER.flip(np.array([np.nan]), np.array([1])) == pytest.approx(16 * 9.80665 / 32768)


def test_a_height_is_a_pressure_within_the_sensors_range() -> None:
    """The highest bit is half of the range: 59.5 kPa, which at 100 m leaves 40.5 kPa or 7.1 km."""
    assert flip_height(np.array([100.0]), np.zeros(1, dtype=np.int64)).tolist() == [100.0]
    (high,) = flip_height(np.array([100.0]), np.array([1 << 23]))
    assert high == pytest.approx(7100.0, abs=50.0)
    drawn = np.random.default_rng(1).integers(0, 1 << 24, 1000)
    heights = flip_height(np.full(1000, 20.0), drawn)
    assert heights.min() > -1500.0
    assert heights.max() < 27_000.0


def test_all_sensors_on_buses_are_noise_and_the_rest_is_not() -> None:
    live, sham = hook(), hook(sham=True)
    true, mine, other = readings(), readings(), readings()
    assert live.on_sensors(2 * S - 1, readings()) == []
    acts = live.on_sensors(2 * S, mine)
    assert acts == sham.on_sensors(2 * S, other)
    assert acts == [SensorAct(vehicle, sensor) for vehicle in ("blue/b1", "blue/b2") for sensor in COLUMNS]
    for one in fields(Sensors):
        want = getattr(true, one.name)
        assert getattr(other, one.name).tobytes() == want.tobytes()
        assert (getattr(mine, one.name) == want).any() == (one.name not in COLUMNS.values())
    assert live.on_sensors(3 * S, readings()) == []


@pytest.mark.parametrize("sensor", COLUMNS)
def test_one_sensor_alone(sensor: str) -> None:
    live = hook(sensors=[sensor])
    mine = readings()
    assert live.on_sensors(2 * S, mine) == [SensorAct("blue/b1", sensor), SensorAct("blue/b2", sensor)]
    true, names = readings(), [one.name for one in fields(Sensors)]
    altered = {name for name in names if getattr(mine, name).tobytes() != getattr(true, name).tobytes()}
    assert altered == {COLUMNS[sensor]}


def test_words_are_uniform_at_one_half_and_rare_at_a_low_rate() -> None:
    live = hook(sensors=["gyro"])
    rates = np.array([told(live, 2 * S + tick * MS).gyro_radps for tick in range(500)])
    full = np.radians(2000.0)
    assert np.abs(rates).max() > 0.99 * full
    assert abs(rates.mean()) < 0.05 * full
    assert rates.std() == pytest.approx(full / np.sqrt(3.0), rel=0.05)
    rare = hook(sensors=["gyro"], bit_error_rate=0.001)
    share = np.mean([told(rare, 2 * S + t * MS).gyro_radps != readings().gyro_radps for t in range(1000)])
    assert share == pytest.approx(1.0 - 0.999**16, rel=0.25)


def test_a_slow_sensor_repeats_and_aircraft_and_copies_are_told_their_own() -> None:
    live = hook()
    first, copied = told(live, 2 * S), copy.deepcopy(live)
    second = told(live, 2 * S + 10 * MS)
    assert second.baro_up_m.tolist() == first.baro_up_m.tolist(), "it has not measured again"
    assert second.gyro_radps.tolist() != first.gyro_radps.tolist()
    assert told(copied, 2 * S + 10 * MS).gyro_radps.tolist() == second.gyro_radps.tolist()
    assert told(live, 3 * S).baro_up_m.tolist() != first.baro_up_m.tolist()
    assert first.gyro_radps[0].tolist() != first.gyro_radps[1].tolist()


@pytest.mark.parametrize(("params", "named"), [({"sensors": []}, "sensors"), ({"bit_error_rate": 0.6}, "bit_error")])
def test_bad_parameters_are_named(params: dict[str, Any], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        hook(**params)
