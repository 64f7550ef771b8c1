"""Wall queries: whether a straight leg is clear of buildings, and the corners to fly around."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.city.wall_index import NO_WALLS, WallIndex, distance_to_footprint
from skyrange.core.compiled import compiled
from skyrange.vehicle.avoidance.contract import Vector

Ints = NDArray[np.int64]


def walls_of(city: City | None) -> WallIndex:
    """A city's walls; none over open country."""
    return NO_WALLS if city is None else city.walls()


def find_buildings_nearby(walls: WallIndex, points: NDArray[np.float64], margin_m: float) -> Ints:
    """Buildings, in order, that come within `margin_m` of the box around some points (n, 3)."""
    low, high = points.min(axis=0) - margin_m, points.max(axis=0) + margin_m
    box = walls.box
    return np.flatnonzero(
        (box[:, 2] >= low[0]) & (box[:, 0] <= high[0]) & (box[:, 3] >= low[1]) & (box[:, 1] <= high[1])
        & (box[:, 5] > low[2]) & (box[:, 4] < high[2])
    )  # fmt: skip


@compiled
def _apart2(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Squared distance of a point from a segment in the plane."""
    dx, dy = bx - ax, by - ay
    length2 = dx * dx + dy * dy
    share = ((px - ax) * dx + (py - ay) * dy) / length2 if length2 > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    x, y = px - ax - share * dx, py - ay - share * dy
    return x * x + y * y


@compiled
def _crosses(ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float) -> bool:  # noqa: PLR0917
    one = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    two = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
    three = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx)
    four = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
    return (one > 0.0) != (two > 0.0) and (three > 0.0) != (four > 0.0)


@compiled
def is_leg_clear(  # noqa: PLR0917
    walls: WallIndex, near: Ints, ax: float, ay: float, az: float, bx: float, by: float, bz: float, margin_m: float
) -> bool:
    """Whether a straight leg keeps `margin_m` from the buildings `near`, as `City.is_clear` has it.

    Above a roof or below a base by the margin is clear; a sloping leg is judged by its lowest and highest point.
    """
    low, high = min(az, bz) - margin_m, max(az, bz) + margin_m
    west, east = min(ax, bx) - margin_m, max(ax, bx) + margin_m
    south, north = min(ay, by) - margin_m, max(ay, by) + margin_m
    for k in range(near.shape[0]):
        b = near[k]
        if walls.box[b, 5] <= low or walls.box[b, 4] >= high:
            continue
        if walls.box[b, 2] < west or walls.box[b, 0] > east or walls.box[b, 3] < south or walls.box[b, 1] > north:
            continue
        for edge in range(walls.edge_start[b], walls.edge_start[b + 1]):
            cx, cy, dx, dy = walls.edges[edge, 0], walls.edges[edge, 1], walls.edges[edge, 2], walls.edges[edge, 3]
            if max(cx, dx) < west or min(cx, dx) > east or max(cy, dy) < south or min(cy, dy) > north:
                continue
            if _crosses(ax, ay, bx, by, cx, cy, dx, dy):
                return False
            least = min(_apart2(cx, cy, ax, ay, bx, by), _apart2(dx, dy, ax, ay, bx, by))
            least = min(least, _apart2(ax, ay, cx, cy, dx, dy), _apart2(bx, by, cx, cy, dx, dy))
            if least < margin_m * margin_m:
                return False
        if distance_to_footprint(walls, b, ax, ay)[0]:
            return False
    return True


@compiled
def clearance(walls: WallIndex, near: Ints, x: float, y: float, z: float, most_m: float) -> float:
    """How far a place is from the walls beside it, at most `most_m`; 0 inside a building."""
    best = most_m
    for k in range(near.shape[0]):
        b = near[k]
        if walls.box[b, 5] <= z - most_m or walls.box[b, 4] >= z + most_m:
            continue
        if walls.box[b, 0] - x > best or x - walls.box[b, 2] > best:
            continue
        if walls.box[b, 1] - y > best or y - walls.box[b, 3] > best:
            continue
        inside, away, _, _ = distance_to_footprint(walls, b, x, y)
        best = 0.0 if inside else min(best, away)
    return best


@compiled
def corners(walls: WallIndex, near: Ints, off_m: float, out: NDArray[np.float64]) -> int:
    """Places (n, 2) `off_m` outside the convex corners of buildings, into `out`; how many of its rows are filled.

    A corner's outside is where its incoming side goes on, less where its outgoing side goes: for either sense of a
    ring. Reflex corners come out inside the building; whoever asks sorts these out by their clearance.
    """
    count = 0
    for k in range(near.shape[0]):
        begin, end = walls.edge_start[near[k]], walls.edge_start[near[k] + 1]
        ring = begin
        for edge in range(begin, end):
            x, y = walls.edges[edge, 2], walls.edges[edge, 3]
            follow = edge + 1
            if follow == end or walls.edges[follow, 0] != x or walls.edges[follow, 1] != y:
                follow = ring
                ring = edge + 1
            ix, iy = x - walls.edges[edge, 0], y - walls.edges[edge, 1]
            ox, oy = walls.edges[follow, 2] - x, walls.edges[follow, 3] - y
            i, o = math.sqrt(ix * ix + iy * iy), math.sqrt(ox * ox + oy * oy)
            if i == 0.0 or o == 0.0:
                continue
            nx, ny = ix / i - ox / o, iy / i - oy / o
            length = math.sqrt(nx * nx + ny * ny)
            if length < 0.35 or count == out.shape[0]:  # a bend of less than 20 degrees is no corner
                continue
            out[count, 0], out[count, 1] = x + off_m * nx / length, y + off_m * ny / length
            count += 1
    return count


def is_straight_clear(walls: WallIndex, start: Vector, goal: Vector, margin_m: float) -> bool:
    """Whether a straight leg keeps the margin, or what its ends leave of it: they may be near a wall themselves.

    Four fifths of it, in fact: who has just come round a corner is a little nearer than the corner's own place.
    """
    ends = np.array((start, goal))
    near = find_buildings_nearby(walls, ends, margin_m)
    if not near.size:
        return True
    least = min(clearance(walls, near, *start, margin_m), clearance(walls, near, *goal, margin_m))
    return least > 0.0 and is_leg_clear(walls, near, *start, *goal, 0.79 * least)
