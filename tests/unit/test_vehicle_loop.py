"""One turn of the main loop: the mixer's signs and limits, the landing detector, the crash check."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from skyrange.vehicle.builtin import loop
from skyrange.vehicle.builtin.control import gains
from skyrange.vehicle.builtin.control.motor_control import mix_motors, thrust_to_actuator
from skyrange.vehicle.builtin.layout import ESTIMATE, FLIGHT, GAINS, LEGS, ControlMode, FlightEvent, new_records
from skyrange.vehicle.builtin.parameters.table import SETTINGS, fill_settings
from skyrange.world.airframes import IRIS

DT = 0.0025


class Rows:
    """One aircraft's rows in all tables of the loop."""

    def __init__(self) -> None:
        self.estimate, self.flight = new_records(ESTIMATE, 1), new_records(FLIGHT, 1)
        self.legs, self.gains = new_records(LEGS, 1), new_records(GAINS, 1)
        self.settings, self.out = np.zeros(1, SETTINGS), np.zeros((1, 4))
        fill_settings(self.settings, 0, "v", IRIS, 1, {})
        gains.set_motor_factors(self.gains, 0, IRIS)
        gains.compute_gains(self.gains[0], self.settings[0], DT)
        for name in ("speed_xy", "speed_up", "speed_down", "accel_xy", "accel_z"):
            self.flight[name] = 1.0
        self.flight["armed"] = 1

    def turn(self, seconds: float) -> int:
        """Run the loop; returns how often it raised a flag."""
        set_index = np.zeros(1, dtype=np.int64)
        tables = (self.estimate, self.flight, self.legs, set_index, self.gains, self.settings, self.out)
        return sum(loop.run_loop(*tables, DT) for _ in range(round(seconds / DT)))


def mixed(throttle: float, roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Thrust shares of front right, rear left, front left, rear right: `Thrust_Linearization::actuator_to_thrust`."""
    table = new_records(GAINS, 1)
    settings = np.zeros(1, SETTINGS)
    fill_settings(settings, 0, "v", IRIS, 1, {})
    gains.set_motor_factors(table, 0, IRIS)
    gains.compute_gains(table[0], settings[0], DT)
    factors: list[Any] = [tuple(table[name][0].tolist()) for name in ("roll_factor", "pitch_factor", "yaw_factor")]
    curve: Any = tuple(float(table[name][0]) for name in ("expo", "expo_a", "expo_b", "expo_c"))
    spin = float(table["spin_min"][0]), float(table["spin_range"][0])
    thrusts = mix_motors(factors[0], factors[1], factors[2], throttle, throttle, roll, pitch, yaw)[1:]
    out = (np.array([thrust_to_actuator(curve, spin, thrust) for thrust in thrusts]) - 0.15) / (0.95 - 0.15)
    expo = IRIS.thrust_expo
    share: np.ndarray = (1 - expo) * out + expo * out**2
    return share


def test_mixer_signs_and_thrust() -> None:
    assert mixed(0.5, 0, 0, 0) == pytest.approx([0.5] * 4)
    assert mixed(0.5, 0.2, 0, 0) == pytest.approx([0.4, 0.6, 0.6, 0.4])  # right side down: more on the left
    assert mixed(0.5, 0, 0.2, 0) == pytest.approx([0.4, 0.6, 0.4, 0.6])  # nose down: more behind
    assert mixed(0.5, 0, 0, 0.2) == pytest.approx([0.4, 0.4, 0.6, 0.6])  # turn left: less of the counter-clockwise
    assert [rotor.spin for rotor in IRIS.rotors] == [1.0, 1.0, -1.0, -1.0]


def test_attitude_comes_before_thrust_and_yaw() -> None:
    full = mixed(1.0, 0.4, 0, 0)
    assert full[1] - full[0] == pytest.approx(0.4)
    assert full.max() <= 1.0 + 1e-9
    torn = mixed(0.5, 1.0, 1.0, 1.0)
    assert torn[1] - torn[0] > 0.7  # rear left against front right
    assert ((torn >= 0.0) & (torn <= 1.0 + 1e-9)).all()


def test_off_and_idle_motors() -> None:
    rows = Rows()
    rows.flight["control"] = ControlMode.OFF
    rows.turn(DT)
    assert rows.out.max() == 0.0
    rows.flight["control"] = ControlMode.IDLE
    rows.flight["landed"] = 1
    rows.turn(0.1)
    assert rows.out == pytest.approx(0.15 * 0.1 / 0.5)  # of MOT_SPIN_MIN, in MOT_SPOOL_TIME (output_logic)
    rows.turn(0.4)
    assert rows.out == pytest.approx(0.1)  # MOT_SPIN_ARM


def test_standing_still_with_least_throttle_is_landed_after_a_second() -> None:
    rows = Rows()
    rows.flight["control"] = ControlMode.LAND
    rows.flight["throttle_i"] = -0.8
    assert rows.turn(0.95) == 0
    assert rows.turn(0.2) == 1
    assert rows.flight["flags"][0] == FlightEvent.LAND_COMPLETE
    assert rows.flight["control"][0] == ControlMode.IDLE


@pytest.mark.parametrize(
    ("field", "value"), [("height", 2.5), ("vel", (0.0, 0.0, -1.2)), ("accel", (0.0, 0.0, -3.0))], ids=str
)
def test_not_landed_while_high_moving_or_falling(field: str, value: Any) -> None:
    rows = Rows()
    rows.flight["control"] = ControlMode.LAND
    rows.flight["throttle_i"] = -0.8
    rows.estimate[field] = value
    rows.turn(1.5)
    assert not rows.flight["flags"][0] & FlightEvent.LAND_COMPLETE


def test_two_seconds_on_its_back_is_a_crash() -> None:
    rows = Rows()
    rows.flight["control"] = ControlMode.VELOCITY
    rows.estimate["quat"] = (math.cos(1.2), math.sin(1.2), 0.0, 0.0)
    rows.estimate["roll"] = 2.4
    rows.turn(1.9)
    assert rows.flight["flags"][0] == 0
    rows.turn(0.2)
    assert rows.flight["flags"][0] == FlightEvent.CRASH
    rows = Rows()
    rows.flight["control"] = ControlMode.VELOCITY
    rows.turn(3.0)
    assert rows.flight["flags"][0] == 0
