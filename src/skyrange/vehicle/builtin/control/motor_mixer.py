"""Motor mixer: from thrust and demands of roll, pitch and yaw to the commands of four motors.

After libraries/AP_Motors/AP_MotorsMatrix.cpp (`output_armed_stabilizing`). Without branches where it is computed for
several aircraft in vector registers: what is not needed is computed too, and not selected.
"""

from __future__ import annotations

import math

from skyrange.core.compiled import inlined
from skyrange.vehicle.builtin.control.shaping import clamp

Four = tuple[float, float, float, float]
_YAW_HEADROOM = 0.2  # MOT_YAW_HEADROOM's 200 of 1000


@inlined
def thrust_to_actuator(expo: Four, spin: tuple[float, float], thrust: float) -> float:
    """Return the actuator command for a thrust 0…1: the inverse thrust curve, from MOT_SPIN_MIN to MOT_SPIN_MAX.

    `Thrust_Linearization::thrust_to_actuator`, without the compensation of the battery's voltage, which is off by
    default. `expo` are `GAINS`' expo, expo_a, expo_b, expo_c; `spin` are spin_min and spin_range.
    """
    thrust = clamp(thrust, 0.0, 1.0)
    root = math.sqrt(max(expo[1] + expo[2] * thrust, 0.0))  # the limit lets LLVM compute vectors of roots
    curved = (root if expo[0] > 0.0 else -root) - expo[3]
    linear = abs(expo[0]) <= 1e-6
    return spin[0] + spin[1] * (thrust if linear else curved)


@inlined
def _yaw_allowed(part: float, factor: float, best: float, yaw: float) -> float:
    """Return how much yaw a motor, whose yaw factor is ±½, allows on top of its part in roll and pitch."""
    # up to full thrust where yaw adds to it, else down to none
    return 1.0 + math.copysign(1.0, yaw * factor) * (1.0 - 2.0 * (best + part))


@inlined
def _fit_to_range(throttle: float, average: float, low: float, high: float) -> tuple[float, float, bool]:
    """Return (offset added to every motor, scale of the demands, whether thrust was reduced)."""
    span = high - low
    scale = 1.0 / span if span > 1.0 else 1.0
    scale = min(scale, -average / low) if average + low < 0.0 else scale
    high *= scale
    low *= scale
    more = throttle + low
    cut = scale < 1.0
    most = 1.0 + low - high
    above = more > most
    full = (throttle >= 1.0) | (cut & (more > 0.0)) | ((not cut) & (more >= 0.0) & above)
    more = 0.0 if cut | (more < 0.0) else (most if above else more)
    return more - low, scale, full


@inlined
def mix_motors(
    roll_factor: Four, pitch_factor: Four, yaw_factor: Four,
    throttle: float, average: float, roll: float, pitch: float, yaw: float,
) -> tuple[bool, float, float, float, float]:  # fmt: skip
    """Return whether thrust was reduced, and the thrusts of four motors for a thrust 0…1 and three demands.

    Roll and pitch have priority, then some yaw, then thrust, which may be raised up to `average` for them. Positive
    roll lowers the right side, positive pitch lowers the nose, positive yaw turns left.
    """
    throttle = clamp(throttle, 0.0, 1.0)
    average = clamp(average, throttle, 1.0)
    a = roll * roll_factor[0] + pitch * pitch_factor[0]
    b = roll * roll_factor[1] + pitch * pitch_factor[1]
    c = roll * roll_factor[2] + pitch * pitch_factor[2]
    d = roll * roll_factor[3] + pitch * pitch_factor[3]
    best = min(0.5, average)
    span = 0.5 * (abs(roll) + abs(pitch) + abs(yaw))
    near = (span > min(best, throttle)) | (throttle + span >= 1.0)  # else far from every limit: nothing is reduced
    allowed = min(_yaw_allowed(a, yaw_factor[0], best, yaw), _yaw_allowed(b, yaw_factor[1], best, yaw))
    allowed = min(allowed, min(_yaw_allowed(c, yaw_factor[2], best, yaw), _yaw_allowed(d, yaw_factor[3], best, yaw)))
    allowed = max(min(allowed, 1.0), _YAW_HEADROOM)
    yaw = clamp(yaw, -allowed, allowed) if near else yaw
    a += yaw * yaw_factor[0]
    b += yaw * yaw_factor[1]
    c += yaw * yaw_factor[2]
    d += yaw * yaw_factor[3]
    base, scale, full = _fit_to_range(throttle, average, min(min(a, b), min(c, d)), max(max(a, b), max(c, d)))
    base = base if near else throttle
    scale = scale if near else 1.0
    return near & full, base + scale * a, base + scale * b, base + scale * c, base + scale * d
