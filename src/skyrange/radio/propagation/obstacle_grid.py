"""Index of a city's walls for lines: the buildings in each cell of a grid, and the traversal of the grid."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.city.wall_index import NO_WALLS, WallIndex
from skyrange.core.compiled import compiled


class Obstacles(NamedTuple):
    """A city's walls with an index for lines: the grid of `walls`, but each building only in the cells it covers."""

    box: NDArray[np.float64]
    edges: NDArray[np.float64]
    first: NDArray[np.int64]
    """As in `WallIndex`."""
    cells: NDArray[np.int64]
    """(c + 1,): start of each cell's buildings in `inside`."""
    inside: NDArray[np.int32]
    tops: NDArray[np.float64]
    """(c,): the highest roof in each cell."""
    enclosure: NDArray[np.float64]
    """(c, 4): a height from which on no position in the cell has higher walls on two opposite sides within 60 m, to the
    east and west, north and south, north-east and south-west, north-west and south-east."""
    west: float
    south: float
    side: float
    columns: int
    rows: int


def obstacle_index(walls: WallIndex = NO_WALLS) -> Obstacles:
    """Build the index of some walls."""
    west, south, side = walls.grid.tolist()
    cells, inside, tops = _index(walls)
    enclosure = _enclosing_heights(tops, walls.columns, walls.rows)
    shared = (walls.box, walls.edges, walls.edge_start, cells, inside, tops, enclosure)
    return Obstacles(*shared, west, south, side, walls.columns, walls.rows)


@compiled
def _index(walls: WallIndex) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float64]]:
    """Each cell's buildings and their highest roof: counted first, then filled from last to first."""
    count = walls.columns * walls.rows
    cells, tops = np.zeros(count + 1, dtype=np.int64), np.full(count, -math.inf)
    inside = np.empty(0, dtype=np.int32)
    for turn in range(2):
        for b in range(walls.box.shape[0] - 1, -1, -1):
            column0 = int((walls.box[b, 0] - walls.grid[0]) / walls.grid[2])
            column1 = int((walls.box[b, 2] - walls.grid[0]) / walls.grid[2])
            row0 = int((walls.box[b, 1] - walls.grid[1]) / walls.grid[2])
            row1 = int((walls.box[b, 3] - walls.grid[1]) / walls.grid[2])
            for row in range(row0, row1 + 1):
                for column in range(column0, column1 + 1):
                    cell = row * walls.columns + column
                    if turn == 0:
                        cells[cell] += 1
                        tops[cell] = max(tops[cell], walls.box[b, 5])
                    else:
                        cells[cell] -= 1
                        inside[cells[cell]] = b
        if turn == 0:  # each start stands at its cell's end and moves down while the cell is filled
            for cell in range(count):
                cells[cell + 1] += cells[cell]
            inside = np.empty(cells[count], dtype=np.int32)
    return cells, inside, tops


@compiled
def _enclosing_heights(tops: NDArray[np.float64], columns: int, rows: int) -> NDArray[np.float64]:
    """`Obstacles.enclosure`: for each orientation of opposite sides, the highest roof of the lower side.

    A side is what a ray from anywhere in the cell can meet: the cell itself and the next three in its direction, for a
    diagonal ray with those beside them. Cells are at least 20 m wide.
    """
    enclosure = np.empty((columns * rows, 4))
    for cell in range(columns * rows):
        row, column = cell // columns, cell % columns
        for orientation in range(4):
            lower = math.inf
            for sign in range(-1, 2, 2):
                highest = -math.inf
                for i in range(4):
                    for j in range(4):
                        if orientation == 0:
                            if i > 0:
                                continue
                            r, c = row, column + sign * j
                        elif orientation == 1:
                            if j > 0:
                                continue
                            r, c = row + sign * i, column
                        else:
                            if abs(i - j) > 1:
                                continue
                            r, c = row + sign * i, column + sign * (j if orientation == 2 else -j)
                        if 0 <= r < rows and 0 <= c < columns:
                            highest = max(highest, tops[r * columns + c])
                lower = min(lower, highest)
            enclosure[cell, orientation] = lower
    return enclosure


class GridTraversal(NamedTuple):
    """State of a line's traversal of the grid (Amanatides & Woo, Eurographics 1987)."""

    column: int
    row: int
    east: int
    north: int
    """Step to the next cell, -1 or 1."""
    next_x: float
    next_y: float
    """Share of the line up to the next cell boundary in each direction."""
    each_x: float
    each_y: float
    begin: float
    end: float
    """Shares of the line at which it enters and leaves the grid; it misses the grid unless begin is below end."""


@compiled
def start_traversal(  # noqa: PLR0917
    west: float, south: float, side: float, columns: int, rows: int, ax: float, ay: float, dx: float, dy: float
) -> GridTraversal:
    """Begin the traversal of the grid along a line."""
    x, y = (ax - west) / side, (ay - south) / side
    wx, wy = dx / side, dy / side
    begin, end = 0.0, 1.0
    if wx != 0.0:
        one, two = -x / wx, (columns - x) / wx
        begin, end = max(begin, min(one, two)), min(end, max(one, two))
    elif x < 0.0 or x >= columns:
        end = -1.0
    if wy != 0.0:
        one, two = -y / wy, (rows - y) / wy
        begin, end = max(begin, min(one, two)), min(end, max(one, two))
    elif y < 0.0 or y >= rows:
        end = -1.0
    column = min(max(math.floor(x + begin * wx), 0), columns - 1)
    row = min(max(math.floor(y + begin * wy), 0), rows - 1)
    next_x = next_y = each_x = each_y = math.inf
    if wx != 0.0:
        next_x, each_x = (column + (1.0 if wx > 0.0 else 0.0) - x) / wx, abs(1.0 / wx)
    if wy != 0.0:
        next_y, each_y = (row + (1.0 if wy > 0.0 else 0.0) - y) / wy, abs(1.0 / wy)
    return GridTraversal(
        column, row, 1 if wx > 0.0 else -1, 1 if wy > 0.0 else -1, next_x, next_y, each_x, each_y, begin, end
    )
