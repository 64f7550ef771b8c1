"""Broad phase of collision detection: bounds that let a tick check hardly any aircraft.

`travelled` is the sum over ticks of the longest distance that any aircraft of a run moved, so two of its aircraft with
a gap g cannot touch before it has grown by g/2. Near pairs are listed over a grid of cells, and the list is made again
when `travelled` has grown by half of `NEAR_M`. This only skips pairs that cannot touch, so no result depends on who
else flies. Each run of a batch has its own `travelled` and its own search, because bodies of different runs never
meet. Against walls the bound is each aircraft's own `odometer_m`, because the floor below it may change when it is
checked.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from skyrange.city.wall_index import MARGIN_M, WallIndex, cell_of, distance_to_box, distance_to_footprint
from skyrange.core.compiled import compiled
from skyrange.world.airframes import Airframe

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

NEAR_M = 10.0
"""A pair with a smaller gap is on the list of near pairs."""
ON_ROOF_M = 0.02  # gear at most this far below a roof stands on it
_EDGE_M = 0.25  # accuracy of a roof's edge as the end of the floor: half a gear's width

RADIUS, HEIGHT, CG, MASS, PER_JX, PER_JY, PER_JZ, PROPELLER, ROTORS = range(9)  # then two per rotor
"""Columns of `shape_row`."""


def shape_row(airframe: Airframe) -> list[float]:
    """An airframe's numbers as the kernels read them."""
    row = [airframe.radius_m, airframe.height_m, airframe.cg_height_m, airframe.mass_kg]
    row += [1.0 / moment for moment in airframe.inertia_kgm2]
    row.append(airframe.propeller_m)
    for rotor in airframe.rotors:
        row += [rotor.forward_m, rotor.left_m]
    return row


@compiled
def is_search_due(travelled: Floats, step2_m2: Floats, census_due: Floats, far: Floats) -> bool:
    """Write to `far` (runs,) how far the aircraft of each run have `travelled` with the last tick, in which the longest
    distance squared was `step2_m2` (runs,); returns whether a run is beyond `census_due`, its next search for pairs.
    """
    due = False
    for run in range(far.shape[0]):
        far[run] = travelled[run] + math.sqrt(step2_m2[run])
        due |= far[run] > census_due[run]
    return due


@compiled
def count_due(far: Floats, run: Ints, pairs: Ints, pair_due: Floats, odometer_m: Floats, wall_due: Floats) -> int:
    """How many pairs and aircraft have to be checked; `far` (runs,) is how far the aircraft of each run have travelled,
    and `run` (n,) the run of each.
    """
    count = 0
    for k in range(pair_due.shape[0]):
        count += far[run[pairs[k, 0]]] > pair_due[k]
    for i in range(wall_due.shape[0]):
        count += odometer_m[i] > wall_due[i]
    return count


@compiled
def cylinder_gap(a: Floats, b: Floats, radii: float, height_a: float, height_b: float) -> float:
    """Distance between two cylinders, 0 if they overlap."""
    x, y = a[0] - b[0], a[1] - b[1]
    across = max(math.sqrt(x * x + y * y) - radii, 0.0)
    up = max(max(a[2] - b[2] - height_b, b[2] - a[2] - height_a), 0.0)
    return math.sqrt(across * across + up * up)


@compiled
def _bucket(column: int, row: int, mask: int) -> int:
    return (column * 73856093 ^ row * 19349663) & mask


@compiled
def list_near_pairs(
    order: Ints, shape: Floats, airframe: Ints, position: Floats, travelled: float
) -> tuple[NDArray[np.int64], Floats]:
    """List all pairs with a gap below `NEAR_M` among the rows in `order`, which is that of their ids: rows (k, 2), and
    `travelled` at which to check each (k,).
    """
    n = order.shape[0]
    widest = 0.0
    for f in range(shape.shape[0]):
        widest = max(widest, shape[f, RADIUS])
    side = NEAR_M + 2.0 * widest
    size = 1
    while size < 2 * n:
        size *= 2
    head = np.full(size, -1, dtype=np.int64)
    follow = np.full(n, -1, dtype=np.int64)
    cell = np.empty((n, 2), dtype=np.int64)
    for k in range(n - 1, -1, -1):  # from the last to the first, so that a chain is in ascending order
        i = order[k]
        cell[k, 0], cell[k, 1] = math.floor(position[i, 0] / side), math.floor(position[i, 1] / side)
        bucket = _bucket(cell[k, 0], cell[k, 1], size - 1)
        follow[k] = head[bucket]
        head[bucket] = k
    pairs = np.empty((4 * n, 2), dtype=np.int64)
    until = np.empty(4 * n)
    count = 0
    for k in range(n):
        i = order[k]
        begin = count
        for column in range(cell[k, 0] - 1, cell[k, 0] + 2):
            for row in range(cell[k, 1] - 1, cell[k, 1] + 2):
                other = head[_bucket(column, row, size - 1)]
                while other >= 0:
                    if other > k and cell[other, 0] == column and cell[other, 1] == row:
                        j = order[other]
                        a, b = shape[airframe[i]], shape[airframe[j]]
                        gap = cylinder_gap(position[i], position[j], a[RADIUS] + b[RADIUS], a[HEIGHT], b[HEIGHT])
                        if gap < NEAR_M:
                            if count == pairs.shape[0]:
                                pairs = np.concatenate((pairs, np.empty_like(pairs)))
                                until = np.concatenate((until, np.empty_like(until)))
                            place = count  # insertion by id, because cells are visited in spatial order
                            while place > begin and pairs[place - 1, 1] > other:
                                pairs[place, 1], until[place] = pairs[place - 1, 1], until[place - 1]
                                place -= 1
                            pairs[place, 1], until[place] = other, travelled + 0.5 * gap
                            count += 1
                    other = follow[other]
        for place in range(begin, count):
            pairs[place, 0] = i
            pairs[place, 1] = order[pairs[place, 1]]
    return pairs[:count].copy(), until[:count].copy()


@compiled
def floor_and_clearance(walls: WallIndex, place: Floats, radius: float, height: float) -> tuple[float, float]:
    """The height of the floor below a position, 0 for the ground, and how far an aircraft there can move before it
    changes.

    "Changes": it touches a building, or leaves the roof below it, or comes over another one (known to `_EDGE_M`).
    """
    floor, free = 0.0, MARGIN_M - radius
    cell = cell_of(walls, place[0], place[1])
    if cell < 0:
        return floor, free
    for k in range(walls.cell_start[cell], walls.cell_start[cell + 1]):
        b = walls.cell_buildings[k]
        base, top = walls.box[b, 4], walls.box[b, 5]
        if distance_to_box(walls, b, place[0], place[1]) - radius >= free:
            continue
        inside, away, _, _ = distance_to_footprint(walls, b, place[0], place[1])
        above = place[2] >= top - ON_ROOF_M
        if above:
            free = min(free, max(away, _EDGE_M))
        if inside and above:
            floor = max(floor, top)
            continue
        up = max(max(place[2] - top, base - place[2] - height), 0.0)
        across = 0.0 if inside else max(away - radius, 0.0)
        free = min(free, math.sqrt(up * up + across * across))
    return floor, free


@compiled
def find_floors(
    walls: WallIndex, position: Floats, shape: Floats, airframe: Ints, floor: Floats, wall_due: Floats
) -> None:
    """Find the floor below each aircraft at the start, and how far it may move (`wall_due`, -1 inside a building)."""
    for i in range(position.shape[0]):
        p = shape[airframe[i]]
        floor[i], wall_due[i] = floor_and_clearance(walls, position[i], p[RADIUS], p[HEIGHT])
