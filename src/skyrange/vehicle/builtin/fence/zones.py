"""Fence zones: whether a place is inside the polygons and circles of a fence, and its distance from their edges.

After libraries/AC_Fence/AC_PolyFence_loader.cpp `breached` and libraries/AP_Math/polygon.cpp, in metres of the local
frame where ArduPilot uses integer degrees × 10⁻⁷.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.check_layout import CIRCLE_IN, CIRCLE_OUT, POLYGON_IN, POLYGON_OUT

_UNSET = -1e30


@compiled
def _in_polygon(z: Any, first: int, size: int, east: float, north: float) -> bool:
    """Whether an odd number of edges lies on one side (`Polygon_outside`)."""
    inside = False
    for k in range(size):
        a = first + k
        b = first + (k + 1) % size
        if (z.point[a, 0] > east) != (z.point[b, 0] > east):
            across = z.point[b, 0] - z.point[a, 0]
            left = (north - z.point[a, 1]) * across
            right = (z.point[b, 1] - z.point[a, 1]) * (east - z.point[a, 0])
            if (across < 0.0 and left > right) or (across >= 0.0 and left < right):
                inside = not inside
    return inside


@compiled
def _edge_distance(z: Any, first: int, size: int, east: float, north: float) -> float:
    """Return the distance to the nearest edge, m (`Polygon_closest_distance_point`)."""
    least = 1e30
    for k in range(size):
        a = first + k
        b = first + (k + 1) % size
        d_e = z.point[b, 0] - z.point[a, 0]
        d_n = z.point[b, 1] - z.point[a, 1]
        o_e = east - z.point[a, 0]
        o_n = north - z.point[a, 1]
        square = d_e * d_e + d_n * d_n
        share = 0.0
        if square > 0.0:
            share = min(max((o_e * d_e + o_n * d_n) / square, 0.0), 1.0)
        o_e -= share * d_e
        o_n -= share * d_n
        least = min(least, o_e * o_e + o_n * o_n)
    return math.sqrt(least)


@compiled
def zone_breach(z: Any, east: float, north: float, union: bool) -> tuple[bool, float]:
    """Return whether a place breaches the zones, and how far outside it is, m; negative inside.

    A place must be inside all inclusion zones (with `union`, inside any of them) and outside all exclusion zones. As in
    ArduPilot, the search for the distance ends at the first exclusion polygon that is entered.
    """
    if z.count == 0:
        return False, 0.0
    far = _UNSET
    inclusions = 0
    left = 0
    for k in range(z.count):
        if z.kind[k] != POLYGON_IN:
            continue
        inclusions += 1
        edge = _edge_distance(z, z.first[k], z.size[k], east, north)
        if _in_polygon(z, z.first[k], z.size[k], east, north):
            far = max(far, -edge)
        else:
            left += 1
            far = min(far, edge) if far > 0.0 else edge
    for k in range(z.count):
        if z.kind[k] != POLYGON_OUT:
            continue
        edge = _edge_distance(z, z.first[k], z.size[k], east, north)
        if _in_polygon(z, z.first[k], z.size[k], east, north):
            return True, edge
        far = max(far, -edge)
    for k in range(z.count):
        if z.kind[k] != CIRCLE_OUT:
            continue
        edge = z.radius[k] - math.hypot(east - z.point[z.first[k], 0], north - z.point[z.first[k], 1])
        far = max(far, edge)
        if edge > 0.0:
            return True, far
    for k in range(z.count):
        if z.kind[k] != CIRCLE_IN:
            continue
        inclusions += 1
        edge = math.hypot(east - z.point[z.first[k], 0], north - z.point[z.first[k], 1]) - z.radius[k]
        far = max(far, edge)
        if edge > 0.0:
            left += 1
    broken = (inclusions > 0 and left == inclusions) if union else left > 0
    return broken, far if far > _UNSET else 0.0
