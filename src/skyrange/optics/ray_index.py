"""Index of a city's surfaces for rays: in each cell of a grid the walls that cross it, by building.

Each piece of a cell is one building there: its walls within the cell, and whether the cell's reference point, which is
on no wall, is inside its footprint. A position in the cell is inside if the line from the reference point to it crosses
an odd number of these walls, so a roof is tested without the walls of other cells.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.city.wall_index import NO_WALLS, WallIndex
from skyrange.core.compiled import compiled

CELL_M: Final = 12.0
"""Side of a cell; larger for a city of more than `_MAX_CELLS`."""
_MAX_CELLS: Final = 1_000_000
_SLACK_M: Final = 1e-6
"""A wall that misses a cell by less is listed in it, so that rounding loses none."""
_CLEAR_M: Final = 1e-3
"""A reference point is at least this far from the lines of all walls in its cell."""
_TRIES: Final = 64
_STEP_X: Final = 0.7548776662466927
_STEP_Y: Final = 0.5698402909980532
"""Inverse powers of the plastic number: multiples of them, modulo 1, are spread evenly over a square (Roberts, "The
unreasonable effectiveness of quasirandom sequences", 2018)."""
_EDGE_M: Final = 0.5
"""How far the grid goes beyond the outermost walls."""


class RayIndex(NamedTuple):
    """A city's surfaces as arrays: c cells, p pieces, w walls; a wall is listed in each cell that it crosses."""

    cell_start: NDArray[np.int64]
    """(c + 1,): start of each cell's pieces; cells are ordered east, then north."""
    cell_top: NDArray[np.float64]
    """(c,): the highest roof in each cell, minus infinity without any."""
    cell_point: NDArray[np.float64]
    """(c, 2): reference point of each cell, east and north."""
    piece_start: NDArray[np.int64]
    """(p + 1,): start of each piece's walls."""
    piece_building: NDArray[np.int32]
    piece_inside: NDArray[np.bool_]
    """(p,): whether the reference point of the cell is inside the building's footprint."""
    piece_span: NDArray[np.float64]
    """(p, 2): base and top of the building."""
    walls: NDArray[np.float64]
    """(w, 4): from east, north to east, north."""
    west: float
    south: float
    side: float
    columns: int
    rows: int
    top: float
    """The highest roof."""

    def __deepcopy__(self, memo: Any) -> RayIndex:
        """Itself: it is never written to, and copies of agents share it."""
        return self


def build_ray_index(walls: WallIndex = NO_WALLS, cell_m: float = CELL_M) -> RayIndex:
    """Build the index of a city's walls (`City.walls`) with cells of `cell_m`. Without walls it has no cells."""
    box = walls.box
    if not len(box):
        starts = np.zeros(1, dtype=np.int64)
        pieces = (starts, np.empty(0, dtype=np.int32), np.empty(0, dtype=np.bool_), np.empty((0, 2)))
        return RayIndex(
            starts, np.empty(0), np.empty((0, 2)), *pieces, np.empty((0, 4)), 0.0, 0.0, cell_m, 0, 0, -math.inf
        )
    west, south = (box[:, :2].min(axis=0) - _EDGE_M).tolist()
    east, north = (box[:, 2:4].max(axis=0) + _EDGE_M).tolist()
    side = max(cell_m, math.sqrt((east - west) * (north - south) / _MAX_CELLS))
    columns, rows = math.ceil((east - west) / side), math.ceil((north - south) / side)
    cell_start, cell_top, piece_start, building, listed = _fill(walls, west, south, side, columns, rows)
    point = _choose_points(cell_start, piece_start, listed, west, south, side, columns)
    inside = _test_points(walls, cell_start, building, point)
    span = np.ascontiguousarray(box[building, 4:6])
    arrays = (cell_start, cell_top, point, piece_start, building, inside, span, listed)
    return RayIndex(*arrays, west, south, side, columns, rows, float(box[:, 5].max()))


@lru_cache(maxsize=4)
def index_city(city: City | None) -> RayIndex:
    """The surfaces of a city for rays. Those of the last cities are kept."""
    return build_ray_index() if city is None else build_ray_index(city.walls())


@compiled
def _touches(walls: WallIndex, k: int, east: float, north: float, half: float) -> bool:
    """Whether a wall crosses the square around a centre, or misses it by less than `_SLACK_M`."""
    x0, y0, x1, y1 = walls.edges[k, 0], walls.edges[k, 1], walls.edges[k, 2], walls.edges[k, 3]
    reach = half + _SLACK_M
    if min(x0, x1) > east + reach or max(x0, x1) < east - reach:
        return False
    if min(y0, y1) > north + reach or max(y0, y1) < north - reach:
        return False
    dx, dy = x1 - x0, y1 - y0
    return bool(abs(dx * (north - y0) - dy * (east - x0)) <= reach * (abs(dx) + abs(dy)))


@compiled
def _is_inside(walls: WallIndex, b: int, east: float, north: float) -> bool:
    """Whether a position is inside a footprint: a ray from it to the west crosses an odd number of walls."""
    inside = False
    for k in range(walls.edge_start[b], walls.edge_start[b + 1]):
        x0, y0, x1, y1 = walls.edges[k, 0], walls.edges[k, 1], walls.edges[k, 2], walls.edges[k, 3]
        if (y0 > north) != (y1 > north) and east > x0 + (north - y0) * (x1 - x0) / (y1 - y0):
            inside = not inside
    return inside


@compiled
def _fill(
    walls: WallIndex, west: float, south: float, side: float, columns: int, rows: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]]:
    """Start and highest roof of each cell, start and building of each piece, and the walls.

    Pieces and walls are counted first, then filled, from the last building to the first.
    """
    count = columns * rows
    pieces = np.zeros(count + 1, dtype=np.int64)
    cell_top = np.full(count, -math.inf)
    piece_start = np.zeros(1, dtype=np.int64)
    building = np.empty(0, dtype=np.int32)
    listed = np.empty((0, 4))
    for turn in range(3):  # count pieces; place them and count their walls; fill in the walls
        for b in range(walls.box.shape[0] - 1, -1, -1):
            column0 = max(int((walls.box[b, 0] - _SLACK_M - west) / side), 0)
            column1 = min(int((walls.box[b, 2] + _SLACK_M - west) / side), columns - 1)
            row0 = max(int((walls.box[b, 1] - _SLACK_M - south) / side), 0)
            row1 = min(int((walls.box[b, 3] + _SLACK_M - south) / side), rows - 1)
            for row in range(row0, row1 + 1):
                for column in range(column0, column1 + 1):
                    cell = row * columns + column
                    east, north = west + (column + 0.5) * side, south + (row + 0.5) * side
                    place = piece_start[_find(pieces, building, cell, b)] if turn == 2 else 0
                    number = 0
                    for k in range(walls.edge_start[b], walls.edge_start[b + 1]):
                        if _touches(walls, k, east, north, 0.5 * side):
                            if turn == 2:
                                listed[place + number] = walls.edges[k]
                            number += 1
                    if number == 0 and not _is_inside(walls, b, east, north):
                        continue
                    if turn == 0:
                        pieces[cell] += 1
                        cell_top[cell] = max(cell_top[cell], walls.box[b, 5])
                    elif turn == 1:
                        pieces[cell] -= 1
                        building[pieces[cell]] = b
                        piece_start[pieces[cell] + 1] = number
        if turn == 0:  # each start stands at its cell's end and moves down while the cell is filled
            for cell in range(count):
                pieces[cell + 1] += pieces[cell]
            piece_start = np.zeros(pieces[count] + 1, dtype=np.int64)
            building = np.empty(pieces[count], dtype=np.int32)
        elif turn == 1:
            for p in range(piece_start.shape[0] - 1):
                piece_start[p + 1] += piece_start[p]
            listed = np.empty((piece_start[piece_start.shape[0] - 1], 4))
    return pieces, cell_top, piece_start, building, listed


@compiled
def _find(pieces: NDArray[np.int64], building: NDArray[np.int32], cell: int, b: int) -> int:
    """The piece of a building in a cell, or the cell's last one if it has none there."""
    for p in range(pieces[cell], pieces[cell + 1]):
        if building[p] == b:
            return p
    return int(pieces[cell])


@compiled
def _choose_points(  # noqa: PLR0917
    cell_start: NDArray[np.int64],
    piece_start: NDArray[np.int64],
    listed: NDArray[np.float64],
    west: float,
    south: float,
    side: float,
    columns: int,
) -> NDArray[np.float64]:
    """The reference point of each cell: the centre, or the first of a sequence of points that is on no wall.

    A wall of which a point is exactly on would have two sides there. Of no point that is `_CLEAR_M` from all walls, the
    farthest is taken.
    """
    count = cell_start.shape[0] - 1
    points = np.empty((count, 2))
    for cell in range(count):
        row, column = cell // columns, cell % columns
        best = -1.0
        for n in range(_TRIES):
            across, up = (0.5 + n * _STEP_X) % 1.0, (0.5 + n * _STEP_Y) % 1.0
            east, north = west + (column + across) * side, south + (row + up) * side
            away = math.inf
            for k in range(piece_start[cell_start[cell]], piece_start[cell_start[cell + 1]]):
                x0, y0 = listed[k, 0], listed[k, 1]
                dx, dy = listed[k, 2] - x0, listed[k, 3] - y0
                length = math.sqrt(dx * dx + dy * dy)
                if length > 0.0:
                    away = min(away, abs(dx * (north - y0) - dy * (east - x0)) / length)
            if away > best:
                best, points[cell, 0], points[cell, 1] = away, east, north
            if best > _CLEAR_M:
                break
    return points


@compiled
def _test_points(
    walls: WallIndex, cell_start: NDArray[np.int64], building: NDArray[np.int32], points: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """For each piece, whether the reference point of its cell is inside the building's footprint."""
    inside = np.empty(building.shape[0], dtype=np.bool_)
    for cell in range(cell_start.shape[0] - 1):
        for p in range(cell_start[cell], cell_start[cell + 1]):
            inside[p] = _is_inside(walls, building[p], points[cell, 0], points[cell, 1])
    return inside
