"""What does ArduPilot's JSON physics backend read, and what do its pulse widths mean?

libraries/SITL/SIM_JSON.cpp: the parser looks for keys as text, wants no blank between a key's colon and a bracket, and
takes 1 for true. Local is north-east-down from home, the body forward-right-down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from skyrange.agent.contracts import Floats, Sensors
from skyrange.world.airframes import MOTORS

PWM_MIN: Final = 1000.0
PWM_RANGE: Final = 1000.0
"""MOT_PWM_MIN, and from there to MOT_PWM_MAX, as ArduCopter has them."""
_LINE: Final = (
    b'\n{"timestamp":%.12f,"imu":{"gyro":[%.9g,%.9g,%.9g],"accel_body":[%.9g,%.9g,%.9g]},"position":[0,0,%.9g],'
    b'"quaternion":[%.9g,%.9g,%.9g,%.9g],"velocity":[0,0,0],"rng_1":%.6g,"no_time_sync":1}\n'
)
_ROOT: Final = math.sqrt(0.5)
_FLIP: Final = np.array([1.0, -1.0, -1.0])
"""Forward-left-up to forward-right-down."""


class Motion(NamedTuple):
    """What inertial sensors, barometer and rangefinder see, in ArduPilot's frames: one row per aircraft."""

    gyro_radps: Floats
    """(n, 3)"""
    accel_mps2: Floats
    """(n, 3) specific force: (0, 0, -9.8) at rest and level."""
    down_m: Floats
    """(n,) below home, as the barometer has it."""
    attitude: Floats
    """(n, 4) quaternion w, x, y, z, body to north-east-down."""
    range_m: Floats
    """(n,) above the ground below."""


def motion_of(sensors: Sensors, home_up_m: Floats) -> Motion:
    """The same in ArduPilot's frames. What ArduPilot makes a compass of is the true attitude."""
    w, x, y, z = (sensors.attitude[:, k] for k in range(4))
    # q' = (0, √½, √½, 0) · q · (0, 1, 0, 0): east-north-up to north-east-down, and the body's half turn
    attitude = np.empty_like(sensors.attitude)
    attitude[:, 0] = -_ROOT * (w + z)
    attitude[:, 1] = -_ROOT * (x + y)
    attitude[:, 2] = _ROOT * (y - x)
    attitude[:, 3] = _ROOT * (z - w)
    return Motion(
        sensors.gyro_radps * _FLIP, sensors.accel_mps2 * _FLIP, home_up_m - sensors.baro_up_m, attitude,
        np.array(sensors.rangefinder_m),
    )  # fmt: skip


def between(before: Motion, after: Motion, share: float) -> Motion:
    """The motion `share` of the way from one to the next; the specific force is the mean over the way already."""
    turned = np.where((before.attitude * after.attitude).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    attitude = before.attitude * turned * (1.0 - share) + after.attitude * share
    attitude /= np.sqrt((attitude * attitude).sum(axis=1, keepdims=True))
    return Motion(
        before.gyro_radps * (1.0 - share) + after.gyro_radps * share,
        after.accel_mps2,
        before.down_m * (1.0 - share) + after.down_m * share,
        attitude,
        after.range_m,
    )


def lines(times_s: Sequence[float], motion: Motion) -> list[bytes]:
    """The line for each aircraft; `times_s` is the time on each one's own clock."""
    rows = np.column_stack(
        (times_s, motion.gyro_radps, motion.accel_mps2, motion.down_m, motion.attitude, motion.range_m)
    )
    return [_LINE % tuple(row) for row in rows.tolist()]


def stamp_s(step: int, step_ns: int) -> float:
    """The time of a step since its start: a hair late, because ArduPilot cuts what is below a microsecond."""
    return step * step_ns * 1e-9 * (1.0 + 1e-7)


def commands_of(answers: Sequence[bytes]) -> Floats:
    """(n, motors) commands 0…1 of what processes answer, motors in ArduCopter's order; 0 µs is no pulse."""
    widths = np.frombuffer(b"".join([answer[: 2 * MOTORS] for answer in answers]), dtype="<u2").reshape(-1, MOTORS)
    commands: Floats = np.clip((widths - PWM_MIN) / PWM_RANGE, 0.0, 1.0)
    return commands
