"""What goes to ArduPilot's JSON backend and comes back, without a process: frames, signs, times, widths."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from skyrange.contracts.components import Sensors
from skyrange.vehicle.ardupilot.json_backend.json_lines import format_lines
from skyrange.vehicle.ardupilot.json_backend.motion import (
    WIDTH,
    MeanForce,
    Motion,
    interpolate,
    read_commands,
    step_time_s,
    to_ardupilot_motion,
)
from skyrange.world import Body, World


def sensors_of(heading_deg: float) -> Sensors:
    world = World([Body("a/b", "iris", 3.0, 4.0, heading_deg=heading_deg)])
    world.advance(0)
    return world.sensors(slice(None))


def euler(q: np.ndarray) -> tuple[float, float, float]:
    """Roll, pitch, yaw in degrees of a quaternion body to north-east-down, as ArduPilot has them."""
    w, x, y, z = q
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw) % 360.0


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 200.0, 300.0])
def test_one_that_stands_is_level_heads_as_it_does_and_feels_its_weight(heading_deg: float) -> None:
    motion = to_ardupilot_motion(sensors_of(heading_deg), np.zeros(1))
    roll, pitch, yaw = euler(motion.attitude[0])
    assert (roll, pitch) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert abs((yaw - heading_deg + 180.0) % 360.0 - 180.0) < 1e-9
    assert motion.accel_mps2[0] == pytest.approx([0.0, 0.0, -9.80665])


def test_axes_turn_from_forward_left_up_to_forward_right_down() -> None:
    sensors = sensors_of(90.0)
    gyro, force = np.array([[0.1, 0.2, 0.3]]), np.array([[1.0, 2.0, 10.0]])
    turned = Sensors(
        **{name: getattr(sensors, name) for name in Sensors.__dataclass_fields__}
        | {"gyro_radps": gyro, "accel_mps2": force, "baro_up_m": np.array([12.5])}
    )
    motion = to_ardupilot_motion(turned, np.array([2.0]))
    assert motion.gyro_radps[0].tolist() == [0.1, -0.2, -0.3]
    assert motion.accel_mps2[0].tolist() == [1.0, -2.0, -10.0]
    assert motion.down_m[0] == -10.5


def test_halfway_between_two_attitudes_is_half_the_turn_whatever_their_signs() -> None:
    def standing(yaw_deg: float, sign: float) -> Motion:
        half = math.radians(yaw_deg) / 2
        attitude = sign * np.array([[math.cos(half), 0.0, 0.0, math.sin(half)]])
        return Motion(np.column_stack((np.zeros((1, 3)), np.ones((1, 3)), [yaw_deg], attitude, [0.0])))

    def on_the_way(sign: float, share: float) -> Motion:
        row = np.empty((1, WIDTH))
        interpolate(standing(10.0, 1.0).rows[0], standing(14.0, sign).rows[0], share, row[0])
        return Motion(row)

    for sign in (1.0, -1.0):
        middle = on_the_way(sign, 0.5)
        assert euler(middle.attitude[0])[2] == pytest.approx(12.0, abs=1e-3)
        assert middle.down_m[0] == 12.0
        whole = on_the_way(sign, 1.0)
        assert euler(whole.attitude[0])[2] == pytest.approx(14.0, abs=1e-9)


def test_who_is_asked_in_every_second_tick_feels_the_mean_of_both() -> None:
    mean, felt = MeanForce(2), []
    for force in (2.0, 4.0, 6.0, 8.0):
        motion = Motion(np.zeros((2, 12)))
        mean.add(np.full((2, 3), -force))
        mean.apply(motion, np.array([0, 1] if force in (4.0, 8.0) else [0]))
        felt.append(motion.accel_mps2[:, 2].tolist())
    assert felt == [[2.0, 2.0], [4.0, 3.0], [6.0, 6.0], [8.0, 7.0]]


def test_a_line_is_json_with_a_line_feed_on_both_sides_and_no_blank_before_a_bracket() -> None:
    motion = to_ardupilot_motion(sensors_of(0.0), np.zeros(1))
    (line,) = format_lines([step_time_s(8, 2_500_000)], motion)
    assert line.startswith(b"\n")
    assert line.endswith(b"\n")
    assert b": [" not in line
    told = json.loads(line)
    assert told["imu"]["accel_body"] == pytest.approx([0.0, 0.0, -9.80665])
    assert told["no_time_sync"] == 1
    assert told["quaternion"] == pytest.approx([math.cos(0.0), 0.0, 0.0, 0.0], abs=1e-9) or told[
        "quaternion"
    ] == pytest.approx([-1.0, 0.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("step_ns", [1_000_000, 1_250_000, 2_500_000, 5_000_000])
def test_times_cut_to_microseconds_never_lose_one(step_ns: int) -> None:
    """ArduPilot adds the difference of two times, cut to whole microseconds (SIM_JSON.cpp, `recv_fdm`)."""
    last_s, clock_us, steps = 0.0, 0, 240_000
    for step in range(1, steps + 1):
        told_s = float(f"{step_time_s(step, step_ns):.12f}")
        clock_us += int((told_s - last_s) * 1e6)
        last_s = told_s
    assert clock_us == steps * step_ns // 1000


def test_widths_are_commands_and_no_pulse_is_none() -> None:
    def answer(*widths: int) -> bytes:
        return b"".join(width.to_bytes(2, "little") for width in widths) + bytes(24)

    first, second, other = answer(1000, 1500, 2000, 1150), answer(0, 900, 2100, 65535), answer(1300)
    answers = np.frombuffer(first.ljust(40) + other.ljust(40) * 2 + second.ljust(40), dtype=np.uint8).reshape(2, 2, 40)
    commands = np.full((2, 4), 0.5)
    read_commands(answers, np.array([0, 1]), np.array([0]), commands)
    assert commands.tolist() == [[0.0, 0.5, 1.0, 0.15], [0.5] * 4]
    read_commands(answers, np.array([0, 1]), np.array([1]), commands)
    assert commands.tolist() == [[0.0, 0.5, 1.0, 0.15], [0.0, 0.0, 1.0, 1.0]]
