"""Wall index: a city flattened to edges with a grid of cells, for kernels that look for nearby walls and roofs.

Every cell of the grid lists the buildings within `MARGIN_M` of it, so one look-up gives everything near a position. A
footprint consists of its edges, those of holes included: a point is inside if a ray from it crosses an odd number of
them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.core.compiled import compiled

if TYPE_CHECKING:
    from skyrange.city.buildings import Building

MARGIN_M = 20.0
"""The distance up to which a cell lists buildings."""
CELL_M = 20.0
"""Side of a cell; larger for a city of more than `_MAX_CELLS`."""
_MAX_CELLS = 250_000


class WallIndex(NamedTuple):
    """A city's buildings as arrays: b buildings, e edges, c cells."""

    edges: NDArray[np.float64]
    """(e, 4): from east, north to east, north."""
    edge_start: NDArray[np.int64]
    """(b + 1,): start of each building's edges."""
    box: NDArray[np.float64]
    """(b, 6): west, south, east, north, base and top."""
    cell_start: NDArray[np.int64]
    """(c + 1,): start of each cell's buildings in `cell_buildings`; cells are ordered east, then north."""
    cell_buildings: NDArray[np.int32]
    """Buildings by cell."""
    grid: NDArray[np.float64]
    """(3,): west and south edge of the grid, side of a cell."""
    columns: int
    rows: int


NO_WALLS = WallIndex(
    np.empty((0, 4)),
    np.zeros(1, dtype=np.int64),
    np.empty((0, 6)),
    np.zeros(1, dtype=np.int64),
    np.empty(0, dtype=np.int32),
    np.array([0.0, 0.0, CELL_M]),
    0,
    0,
)
"""The index without any building."""


def build_wall_index(buildings: Sequence[Building]) -> WallIndex:
    """The index of some buildings, in their order. Raises `ValueError` without any."""
    if not buildings:
        raise ValueError("walls need at least one building")
    rings, ring_of = [], []
    for b, building in enumerate(buildings):
        parts = building.shape.geoms if building.shape.geom_type == "MultiPolygon" else [building.shape]
        for ring in chain.from_iterable((part.exterior, *part.interiors) for part in parts):
            rings.append(ring)
            ring_of.append(b)
    points, place = shapely.get_coordinates(rings, return_index=True)
    joined = place[1:] == place[:-1]
    edges = np.hstack((points[:-1], points[1:]))[joined]
    owner = np.asarray(ring_of)[place[:-1][joined]]
    edge_start = np.searchsorted(owner, np.arange(len(buildings) + 1)).astype(np.int64)
    heights = [(building.base_m, building.height_m) for building in buildings]
    box = np.hstack((shapely.bounds([building.shape for building in buildings]), heights))
    west, south = (box[:, :2].min(axis=0) - MARGIN_M).tolist()
    east, north = (box[:, 2:4].max(axis=0) + MARGIN_M).tolist()
    side = max(CELL_M, math.sqrt((east - west) * (north - south) / _MAX_CELLS))
    columns, rows = math.ceil((east - west) / side), math.ceil((north - south) / side)
    grid = np.array([west, south, side])
    cell_start, cell_buildings = _fill_cells(box, grid, columns, rows)
    return WallIndex(
        np.ascontiguousarray(edges),
        edge_start,
        np.ascontiguousarray(box),
        cell_start,
        cell_buildings,
        grid,
        columns,
        rows,
    )


@compiled
def _fill_cells(
    box: NDArray[np.float64], grid: NDArray[np.float64], columns: int, rows: int
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """The lists of all cells: counted first, then filled."""
    cell_start = np.zeros(columns * rows + 1, dtype=np.int64)
    cell_buildings = np.empty(0, dtype=np.int32)
    for turn in range(2):
        for b in range(box.shape[0]):
            column0 = max(int((box[b, 0] - MARGIN_M - grid[0]) / grid[2]), 0)
            column1 = min(int((box[b, 2] + MARGIN_M - grid[0]) / grid[2]), columns - 1)
            row0 = max(int((box[b, 1] - MARGIN_M - grid[1]) / grid[2]), 0)
            row1 = min(int((box[b, 3] + MARGIN_M - grid[1]) / grid[2]), rows - 1)
            for row in range(row0, row1 + 1):
                for column in range(column0, column1 + 1):
                    cell = row * columns + column
                    if turn == 1:
                        cell_buildings[cell_start[cell]] = b
                    cell_start[cell if turn == 1 else cell + 1] += 1
        if turn == 0:
            for cell in range(columns * rows):
                cell_start[cell + 1] += cell_start[cell]
            cell_buildings = np.empty(cell_start[columns * rows], dtype=np.int32)
        else:  # filling moved each start to its end, which is the start of the next cell
            for cell in range(columns * rows, 0, -1):
                cell_start[cell] = cell_start[cell - 1]
            cell_start[0] = 0
    return cell_start, cell_buildings


@compiled
def cell_of(walls: WallIndex, east_m: float, north_m: float) -> int:
    """The cell of a position; -1 outside the grid, where nothing is within `MARGIN_M`."""
    column = math.floor((east_m - walls.grid[0]) / walls.grid[2])
    row = math.floor((north_m - walls.grid[1]) / walls.grid[2])
    if column < 0 or row < 0 or column >= walls.columns or row >= walls.rows:
        return -1
    return int(row) * walls.columns + int(column)


@compiled
def distance_to_box(walls: WallIndex, b: int, east_m: float, north_m: float) -> float:
    """Distance of a position from a footprint's bounding box, 0 within."""
    x = max(max(walls.box[b, 0] - east_m, east_m - walls.box[b, 2]), 0.0)
    y = max(max(walls.box[b, 1] - north_m, north_m - walls.box[b, 3]), 0.0)
    return math.sqrt(x * x + y * y)


@compiled
def distance_to_footprint(walls: WallIndex, b: int, east_m: float, north_m: float) -> tuple[bool, float, float, float]:
    """Whether a position is inside a footprint, its distance to the nearest edge, and that edge's nearest point."""
    inside = False
    best = math.inf
    near_e, near_n = east_m, north_m
    for k in range(walls.edge_start[b], walls.edge_start[b + 1]):
        x0, y0, x1, y1 = walls.edges[k, 0], walls.edges[k, 1], walls.edges[k, 2], walls.edges[k, 3]
        dx, dy = x1 - x0, y1 - y0
        if (y0 > north_m) != (y1 > north_m) and east_m < x0 + (north_m - y0) * dx / dy:
            inside = not inside
        length2 = dx * dx + dy * dy
        share = ((east_m - x0) * dx + (north_m - y0) * dy) / length2 if length2 > 0.0 else 0.0
        share = min(max(share, 0.0), 1.0)
        x, y = x0 + share * dx, y0 + share * dy
        away = (east_m - x) * (east_m - x) + (north_m - y) * (north_m - y)
        if away < best:
            best, near_e, near_n = away, x, y
    return inside, math.sqrt(best), near_e, near_n
