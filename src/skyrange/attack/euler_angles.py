"""Euler angles and quaternions of an attitude."""

from __future__ import annotations

from math import asin, atan2, cos, pi, sin


def wrap_angle(angle_rad: float) -> float:
    """The same angle from -π to π."""
    return (float(angle_rad) + pi) % (2 * pi) - pi


def euler_angles_of(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw in radians of a quaternion, in aerospace sequence."""
    return (
        atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        asin(min(max(2 * (w * y - z * x), -1.0), 1.0)),
        atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )


def quaternion_of(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """The quaternion w, x, y, z of Euler angles in radians, in aerospace sequence."""
    cr, cp, cy = cos(roll / 2), cos(pitch / 2), cos(yaw / 2)
    sr, sp, sy = sin(roll / 2), sin(pitch / 2), sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
