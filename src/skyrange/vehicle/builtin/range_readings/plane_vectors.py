"""Plane vectors: points, lines and segments in a plane, as plain numbers.

After libraries/AP_Math/vector3.cpp, with a height of 0: obstacles of MAVLink are level.
"""

from __future__ import annotations

import math
from typing import Final

Vector2 = tuple[float, float]
TINY: Final = 1.1920929e-7
"""FLT_EPSILON: ArduPilot's is_zero, is_positive and is_negative."""


def dot(a: Vector2, b: Vector2) -> float:
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1]


def length(a: Vector2) -> float:
    """The Euclidean length."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1])


def subtract(a: Vector2, b: Vector2) -> Vector2:
    """`a` minus `b`."""
    return a[0] - b[0], a[1] - b[1]


def step(start: Vector2, way: Vector2, share: float) -> Vector2:
    """The point that is `share` of a way from its start."""
    return start[0] + way[0] * share, start[1] + way[1] * share


def closest_to_origin(start: Vector2, end: Vector2) -> Vector2:
    """The point of a segment that is closest to the origin (`point_on_line_closest_to_other_point`)."""
    way = subtract(end, start)
    square = dot(way, way)
    if square < TINY * TINY:
        return start
    return step(start, way, min(max(-dot(way, start) / square, 0.0), 1.0))


def closest_on_second(end: Vector2, start2: Vector2, end2: Vector2) -> Vector2:
    """The point of the second segment closest to the first, from the origin to `end`.

    `segment_to_segment_closest_point`, whose results at the ends it has, too.
    """
    line1, line2, diff = end, subtract(end2, start2), (-start2[0], -start2[1])
    a, b, c = dot(line1, line1), dot(line1, line2), dot(line2, line2)
    d, e = dot(line1, diff), dot(line2, diff)
    discriminant = a * c - b * b
    if discriminant < TINY:
        top, bottom = e, c
    else:
        s = b * e - c * d
        top, bottom = a * e - b * d, discriminant
        if s < 0.0:
            top, bottom = e, c
        elif s > discriminant:
            top, bottom = e + b, c
    share = 0.0 if top < 0.0 else 1.0 if top > bottom else 0.0 if top == 0.0 else top / bottom
    return step(start2, line2, share)


def crosses_plane(end: Vector2, normal: Vector2, point: Vector2) -> bool:
    """Whether the segment from the origin to `end` meets the plane through `point` (`segment_plane_intersect`)."""
    along, needed = dot(normal, end), dot(normal, point)
    if abs(along) < TINY:
        return abs(needed) < TINY
    return 0.0 <= needed / along <= 1.0
