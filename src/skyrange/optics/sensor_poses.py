"""Rays of a scan from a sensor that moves: position, velocity, attitude and rates of its aircraft at the start."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from skyrange.core import elementary
from skyrange.core.arrays import Floats
from skyrange.core.compiled import compiled
from skyrange.core.errors import InputError
from skyrange.optics.ray_casting import Rays
from skyrange.optics.scan_patterns import Firing
from skyrange.optics.sensor_models import LidarModel


class SensorPose(NamedTuple):
    """How an aircraft moves while a scan lasts; the axes of the sensor are those of the body."""

    position: Floats
    """(3,): of the body, east, north and up in m."""
    velocity: Floats
    """(3,): in m/s."""
    attitude: Floats
    """(4,): quaternion from body (forward, left, up) to local, w first."""
    rates: Floats
    """(3,): about forward, left and up, in rad/s."""
    mount: Floats
    """(3,): place of the sensor on the body, forward, left and up in m."""


class Footprint(NamedTuple):
    """How pulses are sampled: `across` times `up` rays at the centres of equal parts of a rectangular beam."""

    across: int = 1
    up: int = 1
    divergence_rad: tuple[float, float] = (0.0, 0.0)
    """Full angles across and up."""
    aperture_m: tuple[float, float] = (0.0, 0.0)
    """Size where it leaves the sensor, across and up."""


ONE_RAY: Final = Footprint()
"""A beam without width."""


def sample_footprint(model: LidarModel, across: int, up: int) -> Footprint:
    """The beam of a model, sampled by `across` times `up` rays."""
    return Footprint(across, up, model.divergence_rad, model.aperture_m)


def make_pulse_rays(firing: Firing, pose: SensorPose, footprint: Footprint = ONE_RAY, own: int = -1) -> Rays:
    """The rays of all pulses of a scan, `footprint.across · footprint.up` each, in local coordinates.

    Each pulse leaves from where the sensor is at its time, in the attitude that the body then has. `own` is the row of
    the aircraft that carries the sensor. Raises `InputError` for a footprint without rays.
    """
    if min(footprint.across, footprint.up) < 1:
        raise InputError.one("rays", "footprint", repr(footprint), "1 or more rays across and up")
    samples = footprint.across * footprint.up
    count = len(firing.direction) * samples
    rays = Rays(
        np.empty((count, 3)), np.empty((count, 3)), np.repeat(firing.delay_s, samples), np.full(count, own, np.int32)
    )
    spread = np.array([*footprint.divergence_rad, *footprint.aperture_m])
    _fill(firing, pose, footprint.across, footprint.up, spread, rays)
    return rays


@compiled
def _fill(firing: Firing, pose: SensorPose, across: int, up: int, spread: Floats, rays: Rays) -> None:
    turn = np.empty((3, 3))
    origin, direction, side, over = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(firing.direction.shape[0]):
        delay = firing.delay_s[i]
        if i == 0 or delay != firing.delay_s[i - 1]:
            _find_rotation(pose.attitude, pose.rates, delay, turn)
        fx, fy, fz = firing.direction[i, 0], firing.direction[i, 1], firing.direction[i, 2]
        level = math.sqrt(fx * fx + fy * fy)
        # to the left of the beam and over it, in the frame of the sensor
        sx, sy = (-fy / level, fx / level) if level > 0.0 else (0.0, 1.0)
        ux, uy, uz = -fz * sy, fz * sx, fx * sy - fy * sx
        for axis in range(3):
            direction[axis] = turn[axis, 0] * fx + turn[axis, 1] * fy + turn[axis, 2] * fz
            side[axis] = turn[axis, 0] * sx + turn[axis, 1] * sy
            over[axis] = turn[axis, 0] * ux + turn[axis, 1] * uy + turn[axis, 2] * uz
            origin[axis] = (
                pose.position[axis]
                + delay * pose.velocity[axis]
                + turn[axis, 0] * pose.mount[0]
                + turn[axis, 1] * pose.mount[1]
                + turn[axis, 2] * pose.mount[2]
            )
        for row in range(up):
            high = (row + 0.5) / up - 0.5
            for column in range(across):
                left = (column + 0.5) / across - 0.5
                k = (i * up + row) * across + column
                length2 = 0.0
                for axis in range(3):
                    part = direction[axis] + left * spread[0] * side[axis] + high * spread[1] * over[axis]
                    rays.direction[k, axis] = part
                    length2 += part * part
                    rays.origin[k, axis] = origin[axis] + left * spread[2] * side[axis] + high * spread[3] * over[axis]
                length = math.sqrt(length2)
                for axis in range(3):
                    rays.direction[k, axis] /= length


@compiled
def _find_rotation(attitude: Floats, rates: Floats, delay: float, turn: Floats) -> None:
    """Write the rotation (3, 3) from body to local of an attitude that turned at constant rates for `delay`."""
    w, x, y, z = attitude[0], attitude[1], attitude[2], attitude[3]
    speed = math.sqrt(rates[0] * rates[0] + rates[1] * rates[1] + rates[2] * rates[2])
    if speed > 0.0 and delay > 0.0:
        half = 0.5 * speed * delay
        c, s = elementary.cos(half), elementary.sin(half) / speed
        a, b, d = s * rates[0], s * rates[1], s * rates[2]
        w, x, y, z = (
            w * c - x * a - y * b - z * d,
            w * a + x * c + y * d - z * b,
            w * b - x * d + y * c + z * a,
            w * d + x * b - y * a + z * c,
        )
    turn[0, 0], turn[0, 1], turn[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    turn[1, 0], turn[1, 1], turn[1, 2] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    turn[2, 0], turn[2, 1], turn[2, 2] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
