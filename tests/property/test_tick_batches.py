"""Are batches of ticks the same as single ticks, to the bit?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

import skyrange
from skyrange.contracts.components import READINGS_NS, SensorAct, Sensors
from skyrange.contracts.links import Act
from skyrange.contracts.tick_batches import TickProgress
from skyrange.core.errors import ComponentError
from skyrange.core.time import NS_PER_S, Time
from skyrange.kernel.kernel import Kernel
from skyrange.scenario.shipped import load
from skyrange.vehicle.builtin.tick_batch import FleetTickBatch

pytestmark = pytest.mark.rotating

FLIGHTS = {
    "head-on": ["duration_s=60"],  # two collide, fall and hit the ground
    "wind": ["duration_s=40"],  # gusts, in which the air changes every 20 ms
    "gust": ["duration_s=65"],  # a body fault, which acts from 20 s to 60 s
    "city-fleet": ["duration_s=12"],  # walls, several operators, Remote ID
    "mitm-mission": ["duration_s=60"],
    "squares": ["duration_s=30", "sensors.noise=0"],
    "gnss.jump": ["duration_s=45", "attacks.jump.start_s=20.0033"],  # sensor faults, called every 10 ms
    "gnss.multipath": ["duration_s=30"],
    "gnss.drift": [
        "duration_s=45",
        'defences=[{id="check",kind="gnss.barometer"},{id="innovation",kind="gnss.innovation",params={action="reject"}}]',
    ],
}


FAST = {"gnss.jump", "squares"}
"""The others are slow."""


@pytest.mark.parametrize(
    "name", [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in FLIGHTS]
)
def test_batches_are_single_ticks(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load(name, FLIGHTS[name])
    stops: Counter[TickProgress] = Counter()
    run = FleetTickBatch.run

    def counted(batch: FleetTickBatch, first: Time, count: int, *, service: bool) -> tuple[int, TickProgress]:
        begun, stop = run(batch, first, count, service=service)
        stops[stop] += begun > 0
        return begun, stop

    monkeypatch.setattr(FleetTickBatch, "run", counted)
    batched = skyrange.run(scenario, tmp_path / "batched")
    assert stops[TickProgress.WORLD_ADVANCED] > 100
    assert stops[TickProgress.COMPLETE] > 0  # where the run ends, at least
    assert stops[TickProgress.ENGINE_BEGUN] > 0  # a take-off at least
    if name == "head-on":
        assert stops[TickProgress.MOVED] > 0
    monkeypatch.setattr(Kernel, "_make_batch", lambda kernel: None)
    single = skyrange.run(scenario, tmp_path / "single")
    assert batched.manifest["digests"] == single.manifest["digests"]
    assert batched.manifest["outcomes"] == single.manifest["outcomes"]


@dataclass
class Slow:
    """A sensor fault that is called when there are new readings, and adds to one of them."""

    adds_to: str
    by: float
    name: str = "slow"
    vehicles: Sequence[str] = ("blue/b1",)
    slow: bool = True
    called: list[Time] = field(default_factory=list)

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct]:
        self.called.append(now)
        getattr(sensors, self.adds_to)[:] += self.by
        return ()


def test_a_slow_sensor_fault_is_called_every_ten_milliseconds(tmp_path: Path) -> None:
    fault = Slow("baro_up_m", 1.0)
    skyrange.run(load("squares", ["duration_s=2"]), tmp_path / "run", acts=[Act("x", sensor_hooks=[fault])])
    assert fault.called == list(range(0, 2 * NS_PER_S + 1, READINGS_NS))


@pytest.mark.parametrize("name", ["gyro_radps", "accel_mps2", "attitude", "rotor_radps"])
def test_a_slow_sensor_fault_that_alters_fast_readings_is_an_error(name: str, tmp_path: Path) -> None:
    plan = Act("x", sensor_hooks=[Slow(name, 0.1)])
    with pytest.raises(ComponentError, match=f"slow: altered {name}"):
        skyrange.run(load("squares", ["duration_s=2"]), tmp_path / "run", acts=[plan])


@dataclass
class Shaker:
    """A sensor fault that sets gyroscopes and accelerometers at every tick."""

    name: str = "shaker"
    vehicles: Sequence[str] = ("blue/b1",)

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct]:
        sensors.gyro_radps[:] = shaken(now)
        sensors.accel_mps2[:] = -shaken(now)
        return ()


def shaken(now: Time) -> float:
    return float(np.sin(now))


@dataclass
class Integrals:
    """A sensor check that keeps the integrals that it is handed."""

    name: str = "integrals"
    vehicles: Sequence[str] = ("blue/b1",)
    slow: bool = True
    kept: dict[Time, tuple[float, float]] = field(default_factory=dict)

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct]:
        self.kept[now] = float(sensors.delta_angle_rad[0, 0]), float(sensors.delta_velocity_mps[0, 2])
        return ()


def test_a_sensor_check_gets_the_integrals_of_what_attacks_have_made_of_the_readings(tmp_path: Path) -> None:
    check = Integrals()
    plans = [Act("x", sensor_hooks=[Shaker()]), Act("check", sensor_hooks=[check], role="defence")]
    skyrange.run(load("squares", ["duration_s=1"]), tmp_path / "run", acts=plans)
    tick = READINGS_NS // 4
    for now in range(READINGS_NS, NS_PER_S, READINGS_NS):
        turn = sum(shaken(now - k * tick) for k in range(4)) * tick / NS_PER_S
        for held in range(4):
            assert check.kept[now + held * tick] == pytest.approx((turn, -turn), abs=1e-12)
