"""One turn of the main loop: the mixer's signs and limits, the landing detector, the crash check."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from skyrange.vehicle.builtin import control, loop
from skyrange.vehicle.builtin.layout import ESTIMATE, FLIGHT, Control, Flag, zeros
from skyrange.vehicle.builtin.parameters import SETTINGS, fill
from skyrange.world.airframes import IRIS

DT = 0.0025


def rows() -> tuple[Any, Any, Any, Any]:
    estimate, flight = zeros(ESTIMATE, 1), zeros(FLIGHT, 1)
    settings = np.zeros(1, dtype=SETTINGS)
    fill(settings, 0, "v", IRIS, 1, {})
    for name in ("speed_xy", "speed_up", "speed_down", "accel_xy", "accel_z"):
        flight[name] = 1.0
    flight["armed"] = 1
    return estimate, flight, settings, np.zeros((1, 4))


def mixed(throttle: float, roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Thrust shares of front right, rear left, front left, rear right: commands put through the thrust curve."""
    _, _, settings, out = rows()
    control.mix(settings[0], out[0], throttle, roll, pitch, yaw)
    expo = IRIS.thrust_expo
    return (1 - expo) * out[0] + expo * out[0] ** 2


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
    estimate, flight, settings, out = rows()
    flight["control"] = Control.OFF
    loop.turn(estimate, flight, settings, out, DT)
    assert out.max() == 0.0
    flight["control"] = Control.IDLE
    flight["landed"] = 1
    loop.turn(estimate, flight, settings, out, DT)
    assert out == pytest.approx(0.1)  # MOT_SPIN_ARM


def turn_for(seconds: float, estimate: Any, flight: Any, settings: Any, out: Any) -> int:
    flags = 0
    for _ in range(round(seconds / DT)):
        flags += loop.turn(estimate, flight, settings, out, DT)
    return flags


def test_standing_still_with_least_throttle_is_landed_after_a_second() -> None:
    estimate, flight, settings, out = rows()
    flight["control"] = Control.LAND
    flight["throttle_i"] = -0.8
    assert turn_for(0.95, estimate, flight, settings, out) == 0
    assert turn_for(0.2, estimate, flight, settings, out) == 1
    assert flight["flags"][0] == Flag.LANDED
    assert flight["control"][0] == Control.IDLE


@pytest.mark.parametrize(
    ("field", "value"), [("height", 2.5), ("vel", (0.0, 0.0, -1.2)), ("accel", (0.0, 0.0, -3.0))], ids=str
)
def test_not_landed_while_high_moving_or_falling(field: str, value: Any) -> None:
    estimate, flight, settings, out = rows()
    flight["control"] = Control.LAND
    flight["throttle_i"] = -0.8
    estimate[field] = value
    turn_for(1.5, estimate, flight, settings, out)
    assert not flight["flags"][0] & Flag.LANDED


def test_two_seconds_on_its_back_is_a_crash() -> None:
    estimate, flight, settings, out = rows()
    flight["control"] = Control.VELOCITY
    estimate["quat"] = (math.cos(1.2), math.sin(1.2), 0.0, 0.0)
    estimate["roll"] = 2.4
    turn_for(1.9, estimate, flight, settings, out)
    assert flight["flags"][0] == 0
    turn_for(0.2, estimate, flight, settings, out)
    assert flight["flags"][0] == Flag.CRASHED
    estimate, flight, settings, out = rows()
    flight["control"] = Control.VELOCITY
    turn_for(3.0, estimate, flight, settings, out)
    assert flight["flags"][0] == 0
