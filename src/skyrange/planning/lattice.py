"""Search on a lattice of places and layers of height: the quickest way that keeps clear of buildings.

A place is free in a layer if every roof nearby is far enough below. From a free place one goes to its eight neighbours
in the layer, and up and down. The search is A* (Hart, Nilsson & Raphael, 1968) with the straight flight as the
estimate, which is never too long, so that the way is the quickest of the lattice.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from skyrange.city.wall_index import WallIndex, cell_of, distance_to_footprint
from skyrange.core import elementary
from skyrange.core.compiled import compiled

Floats = NDArray[np.float64]

NO_WAY = -1
EXHAUSTED = -2


@compiled
def raise_field(  # noqa: PLR0917
    walls: WallIndex, west: float, south: float, step_m: float, columns: int, rows: int, reach_m: float
) -> Floats:
    """(rows, columns) Height of the highest roof within `reach_m` of each place, in metres; 0 without any.

    `reach_m` is at most `wall_index.MARGIN_M`.
    """
    field = np.zeros((rows, columns))
    for row in range(rows):
        for column in range(columns):
            east_m, north_m = west + column * step_m, south + row * step_m
            cell = cell_of(walls, east_m, north_m)
            if cell < 0:
                continue
            top = 0.0
            for k in range(walls.cell_start[cell], walls.cell_start[cell + 1]):
                b = walls.cell_buildings[k]
                if walls.box[b, 5] <= top:
                    continue
                inside, away, _, _ = distance_to_footprint(walls, b, east_m, north_m)
                if inside or away <= reach_m:
                    top = walls.box[b, 5]
            field[row, column] = top
    return field


@compiled
def search(  # noqa: PLR0917
    field: Floats,
    step_m: float,
    heights_m: Floats,
    margin_m: float,
    start: int,
    goal: int,
    paces: Floats,
    most: int,
) -> tuple[int, NDArray[np.int64]]:
    """The states from `start` to `goal`, and how many were expanded; none and `NO_WAY`, or `EXHAUSTED` after `most`.

    A state is (layer · rows + row) · columns + column. `paces` are those of `Costs`. States of equal cost go by their
    number, so that equal questions have equal answers.
    """
    fastest = paces[:8].max()
    rows, columns = field.shape
    plane = rows * columns
    layers = len(heights_m)
    cost = np.full(layers * plane, np.inf)
    parent = np.full(layers * plane, -1, dtype=np.int64)
    closed = np.zeros(layers * plane, dtype=np.bool_)
    goal_layer, goal_row, goal_column = goal // plane, goal % plane // columns, goal % columns
    cost[start] = 0.0
    heap = [(0.0, start)]
    expanded = 0
    while heap:
        _, state = heapq.heappop(heap)
        if closed[state]:
            continue
        closed[state] = True
        if state == goal:
            break
        expanded += 1
        if expanded > most:
            return EXHAUSTED, np.zeros(0, dtype=np.int64)
        layer, row, column = state // plane, state % plane // columns, state % columns
        for move in range(10):
            to_layer, to_row, to_column = layer, row, column
            if move < 8:
                place = move if move < 4 else move + 1
                to_row += place // 3 - 1
                to_column += place % 3 - 1
            else:
                to_layer += 1 if move == 8 else -1
            if not (0 <= to_layer < layers and 0 <= to_row < rows and 0 <= to_column < columns):
                continue
            top = field[to_row, to_column]
            if top > 0.0 and top + margin_m > heights_m[to_layer]:
                continue
            if move < 8:
                diagonal = to_row != row and to_column != column
                price = step_m * (math.sqrt(2.0) if diagonal else 1.0) / paces[move]
            else:
                price = abs(heights_m[to_layer] - heights_m[layer]) / paces[move]
            other = to_layer * plane + to_row * columns + to_column
            total = cost[state] + price
            if total < cost[other] - 1e-12:
                cost[other] = total
                parent[other] = state
                wide, high = abs(to_column - goal_column), abs(to_row - goal_row)
                flat = max(wide, high) + (math.sqrt(2.0) - 1.0) * min(wide, high)
                rise_m = heights_m[goal_layer] - heights_m[to_layer]
                rest = flat * step_m / fastest + abs(rise_m) / paces[8 if rise_m > 0.0 else 9]
                heapq.heappush(heap, (total + rest, other))
    if not closed[goal]:
        return NO_WAY, np.zeros(0, dtype=np.int64)
    count = 1
    state = goal
    while state != start:
        state = parent[state]
        count += 1
    way = np.zeros(count, dtype=np.int64)
    state = goal
    for k in range(count - 1, -1, -1):
        way[k] = state
        state = parent[state]
    return expanded, way


@compiled
def is_free(field: Floats, west: float, south: float, step_m: float, margin_m: float, a: Floats, b: Floats) -> bool:  # noqa: PLR0917
    """Whether every place near the straight line from `a` to `b` (east, north, up) is free at its lower end."""
    low_m = min(a[2], b[2])
    length = elementary.hypot(b[0] - a[0], b[1] - a[1])
    count = math.ceil(length / (0.25 * step_m)) + 1
    for k in range(count + 1):
        share = k / count
        column = round((a[0] + share * (b[0] - a[0]) - west) / step_m)
        row = round((a[1] + share * (b[1] - a[1]) - south) / step_m)
        if not (0 <= row < field.shape[0] and 0 <= column < field.shape[1]):
            return False
        if field[row, column] > 0.0 and field[row, column] + margin_m > low_m:
            return False
    return True
