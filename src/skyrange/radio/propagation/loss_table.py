"""Loss table: losses between places of transmitters and a grid of receivers that a ray tracer computed, and their
look-up for any two positions.

The table holds the loss between isotropic antennas. What is interpolated is the excess over free space: it changes
slowly, and free space is computed from the real distance and frequency. One of the two positions is replaced by the
nearest place of a transmitter within reach, the excess at the other one is interpolated trilinearly between the points
of the grid. Losses are reciprocal, so either position may stand for the transmitter: the one nearer to a place does, at
equal distances the mean of both counts. So the result is the same in both directions, and exact between a place and a
point of the grid.

Points inside buildings, and those that no path reaches, have no value. An interpolation needs points with at least half
of the weight. The grid ends half a spacing beyond its outermost points; its lowest values hold down to the ground, and
above the highest point there is none. Where the table has no value the caller takes the loss of the city.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core import elementwise
from skyrange.core.compiled import compiled
from skyrange.radio.propagation.path_loss import free_space_db, wavelength_m

NOT_COVERED: Final = math.nan
"""The loss between positions that a table does not cover."""
LEAST_WEIGHT: Final = 0.5
"""The least share of an interpolation's weight on points that have a value."""

MAX_BINS: Final = 200
"""Most bins of the index of places in each direction; for places farther apart the bins are larger than the reach."""

Floats = NDArray[np.float64]


class LossGrid(NamedTuple):
    """Grid of receivers: columns east, rows north, and heights above the ground."""

    west_m: float
    south_m: float
    """The south-western point."""
    spacing_m: float
    columns: int
    rows: int
    heights_m: tuple[float, ...]
    """Ascending."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Heights, rows and columns."""
        return len(self.heights_m), self.rows, self.columns

    @property
    def points_enu_m(self) -> Floats:
        """(heights, rows, columns, 3) positions."""
        up, north, east = np.meshgrid(
            np.array(self.heights_m),
            self.south_m + self.spacing_m * np.arange(self.rows),
            self.west_m + self.spacing_m * np.arange(self.columns),
            indexing="ij",
        )
        return np.stack((east, north, up), axis=-1)


class LossTable(NamedTuple):
    """A loss table as kernels take it: t places, h heights, r rows, c columns; without places it covers nothing."""

    places: Floats
    """(t, 3)"""
    reach_m: float
    reach_up_m: float
    """How far from a place a position may be, horizontally and vertically."""
    excess_db: NDArray[np.float32]
    """(t, h, r, c): loss beyond that of free space, NaN without a value."""
    west: float
    south: float
    spacing: float
    heights: Floats
    bin_first: NDArray[np.int64]
    """Bins of side `bin_side`, columns fastest: where the places in and around each begin in `bin_places`."""
    bin_places: NDArray[np.int32]
    bin_west: float
    bin_south: float
    bin_side: float
    bin_columns: int
    bin_rows: int
    best_gain_db: float
    """How far below free space the smallest loss lies, at least 0."""
    lookups: NDArray[np.int64]
    """(2,): how often a loss was looked up and found, and how often it was not covered."""


def loss_table(
    places_enu_m: Floats, loss_db: NDArray[np.float32], grid: LossGrid, frequency_mhz: float, reach_m: float,
    reach_up_m: float,
) -> LossTable:  # fmt: skip
    """The table of (t, heights, rows, columns) losses in dB between (t, 3) places and the points of a grid."""
    places = np.ascontiguousarray(places_enu_m, dtype=np.float64).reshape(-1, 3)
    excess = np.empty((len(places), *grid.shape), dtype=np.float32)
    for place, place_excess, losses in zip(places, excess, loss_db, strict=True):
        place_excess[:] = losses - free_space_of(place, grid, frequency_mhz)
    first, listed, west, south, side, columns, rows = _bins(places, reach_m)
    finite = excess[np.isfinite(excess)]
    gain = max(0.0, -float(finite.min())) if finite.size else 0.0
    return LossTable(
        places, float(reach_m), float(reach_up_m), excess, grid.west_m, grid.south_m, grid.spacing_m,
        np.array(grid.heights_m, dtype=np.float64), first, listed, west, south, side, columns, rows, gain,
        np.zeros(2, dtype=np.int64),
    )  # fmt: skip


def free_space_of(place_enu_m: Floats, grid: LossGrid, frequency_mhz: float) -> Floats:
    """(heights, rows, columns) losses in free space between a place and the points of a grid, in dB."""
    distance = elementwise.length(grid.points_enu_m - place_enu_m)
    return _free_space(distance.ravel(), float(wavelength_m(frequency_mhz))).reshape(grid.shape)


@compiled
def _free_space(distance: Floats, wavelength: float) -> Floats:
    losses = np.empty_like(distance)
    for k in range(distance.shape[0]):
        losses[k] = free_space_db(distance[k], wavelength)
    return losses


def _bins(places: Floats, reach_m: float) -> tuple[NDArray[np.int64], NDArray[np.int32], float, float, float, int, int]:
    """Lists of the places in each bin and its eight neighbours, so that one bin holds all within a side's length."""
    if not len(places):
        return np.zeros(1, dtype=np.int64), np.empty(0, dtype=np.int32), 0.0, 0.0, 1.0, 0, 0
    low, high = places[:, :2].min(axis=0), places[:, :2].max(axis=0)
    side = max(float(reach_m), float((high - low).max()) / MAX_BINS)
    west, south = (low - side).tolist()
    columns, rows = (np.floor((high - [west, south]) / side).astype(int) + 2).tolist()
    lists: list[list[int]] = [[] for _ in range(columns * rows)]
    for index, (east, north) in enumerate(places[:, :2].tolist()):
        column, row = int((east - west) / side), int((north - south) / side)
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                lists[r * columns + c].append(index)
    first = np.concatenate(([0], np.cumsum([len(indices) for indices in lists]))).astype(np.int64)
    listed = np.array([index for indices in lists for index in indices], dtype=np.int32)
    return first, listed, west, south, side, columns, rows


NO_TABLE: Final = loss_table(
    np.empty((0, 3)), np.empty((0, 1, 1, 1), dtype=np.float32), LossGrid(0.0, 0.0, 1.0, 1, 1, (0.0,)), 2437.0, 1.0, 1.0
)
"""The table that covers nothing."""


@compiled
def nearest_place(table: LossTable, x: float, y: float, z: float) -> tuple[int, float]:
    """The nearest place of a transmitter within reach of a position and its squared distance in m²; -1 for none."""
    best, best_away = -1, math.inf
    column, row = math.floor((x - table.bin_west) / table.bin_side), math.floor((y - table.bin_south) / table.bin_side)
    if not (0 <= column < table.bin_columns and 0 <= row < table.bin_rows):
        return best, best_away
    cell = row * table.bin_columns + column
    for k in range(table.bin_first[cell], table.bin_first[cell + 1]):
        t = table.bin_places[k]
        dx, dy, dz = table.places[t, 0] - x, table.places[t, 1] - y, table.places[t, 2] - z
        aside = dx * dx + dy * dy
        if aside <= table.reach_m * table.reach_m and abs(dz) <= table.reach_up_m and aside + dz * dz < best_away:
            best, best_away = t, aside + dz * dz
    return best, best_away


@compiled
def grid_excess_db(table: LossTable, t: int, x: float, y: float, z: float) -> float:
    """Excess loss between a place and a position, interpolated trilinearly; `NOT_COVERED` where there is none."""
    levels, rows, columns = table.excess_db.shape[1], table.excess_db.shape[2], table.excess_db.shape[3]
    u, v = (x - table.west) / table.spacing, (y - table.south) / table.spacing
    if not (-0.5 <= u <= columns - 0.5 and -0.5 <= v <= rows - 0.5 and 0.0 <= z <= table.heights[levels - 1]):
        return NOT_COVERED
    u, v = min(max(u, 0.0), columns - 1.0), min(max(v, 0.0), rows - 1.0)
    level = 0
    while level + 2 < levels and table.heights[level + 1] <= z:
        level += 1
    w = 0.0
    if levels > 1:
        w = max(0.0, (z - table.heights[level]) / (table.heights[level + 1] - table.heights[level]))
    column, row = min(math.floor(u), max(columns - 2, 0)), min(math.floor(v), max(rows - 2, 0))
    u, v = u - column, v - row
    total = weight = 0.0
    for k in range(2):
        for j in range(2):
            for i in range(2):
                share = (u if i else 1.0 - u) * (v if j else 1.0 - v) * (w if k else 1.0 - w)
                if share > 0.0:
                    value = table.excess_db[t, level + k, row + j, column + i]
                    if value == value:
                        total += share * value
                        weight += share
    return total / weight if weight >= LEAST_WEIGHT else NOT_COVERED


@compiled
def table_loss_db(  # noqa: PLR0917
    table: LossTable, ax: float, ay: float, az: float, bx: float, by: float, bz: float, distance: float,
    wavelength: float,
) -> float:  # fmt: skip
    """Loss between isotropic antennas at two positions `distance` metres apart, in dB; `NOT_COVERED` if the table does
    not cover them.
    """
    from_a, away_a = nearest_place(table, ax, ay, az)
    from_b, away_b = nearest_place(table, bx, by, bz)
    excess = NOT_COVERED
    if from_a >= 0 and away_a <= away_b:
        excess = grid_excess_db(table, from_a, bx, by, bz)
    if from_b >= 0 and (away_b <= away_a or excess != excess):
        other = grid_excess_db(table, from_b, ax, ay, az)
        if excess != excess:
            excess = other
        elif other == other:
            excess = 0.5 * (excess + other)
    if from_a >= 0 and excess != excess and away_b < away_a:
        excess = grid_excess_db(table, from_a, bx, by, bz)
    table.lookups[0 if excess == excess else 1] += 1
    return excess + free_space_db(distance, wavelength)
