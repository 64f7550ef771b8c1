"""Ground grid: heights of the surface below an aircraft from several scans, and the flat discs on it.

Each scan gives every cell the median of its heights, and a cell's height is the median of its scans: so a few wrong
pixels, and a few wrong scans, alter nothing. What fewer than a half of a cell's pixels show, such as a thin post, is
not noticed.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from skyrange.core.arrays import Floats
from skyrange.vehicle.sight.beams import Beams

CELL_M: Final = 0.25
"""Side of a cell: a quarter of the smallest obstacle of a metre that has to be noticed (assumed)."""
CELLS: Final = 64
"""Cells on each side of the grid: 16 m, more than the field of a D435 at its range of 10 m."""
FEWEST: Final = 3
"""Returns of a scan in a cell below which the cell is unknown in this scan."""


class FlatRules(NamedTuple):
    """What a place to land on has to be."""

    clear_m: float
    """Radius of the disc."""
    rough_m: float
    """Largest deviation from the plane that fits it best."""
    slope: float
    """Largest slope of that plane: rise over run."""


class Place(NamedTuple):
    """A flat disc: its centre, and how flat it is."""

    centre: tuple[float, float, float]
    """East, north and up in m."""
    rough_m: float
    slope: float


class GroundGrid:
    """Heights around a centre, north up. Deep copies continue alike."""

    def __init__(self, centre: Floats) -> None:
        """`centre` (2,): east and north in m."""
        self._corner = np.array(centre[:2]) - 0.5 * CELLS * CELL_M
        self._layers: list[Floats] = []

    @property
    def scans(self) -> int:
        """How many scans it has."""
        return len(self._layers)

    def add(self, beams: Beams) -> None:
        """Take in the returns of a scan."""
        points = find_points(beams)
        cells = np.floor((points[:, :2] - self._corner) / CELL_M)
        inside = ((cells >= 0) & (cells < CELLS)).all(axis=1)
        column, row = cells[inside].astype(np.int64).T
        number = column * CELLS + row
        self._layers.append(_find_medians(number, points[inside, 2]).reshape(CELLS, CELLS))

    def heights(self) -> Floats:
        """(CELLS, CELLS): height of each cell by east and north; NaN for those that half of the scans did not show."""
        if not self._layers:
            return np.full((CELLS, CELLS), np.nan)
        layers = np.sort(np.stack(self._layers), axis=0)  # NaN last
        known = (~np.isnan(layers)).sum(axis=0)
        middle = np.maximum(known - 1, 0) // 2
        heights = np.take_along_axis(layers, middle[None], axis=0)[0]
        return np.where(2 * known > len(self._layers), heights, np.nan)

    def known_share(self) -> float:
        """Share of the cells whose height is known."""
        return int((~np.isnan(self.heights())).sum()) / (CELLS * CELLS)

    def find_place(
        self, near: Floats, rules: FlatRules, *, within_m: float = math.inf, refused: list[Floats] | None = None
    ) -> Place | None:
        """The flat disc whose centre is nearest to `near` (2,), of those centred on cells; None without one.

        Every cell of a disc is known. Centres within `rules.clear_m` of one of the `refused` (2,) are left out.
        """
        heights = self.heights()
        reach = math.ceil(rules.clear_m / CELL_M)
        steps = np.arange(-reach, reach + 1)
        x, y = (part.ravel() for part in np.meshgrid(steps, steps, indexing="ij"))
        # a cell of which a corner is in the disc
        beside = np.square(np.maximum(abs(x) - 0.5, 0.0)) + np.square(np.maximum(abs(y) - 0.5, 0.0))
        inside = beside * (CELL_M * CELL_M) <= (rules.clear_m * rules.clear_m)
        x, y = x[inside], y[inside]
        for i, j in self._list_centres(near, reach, within_m, rules, refused or []):
            disc = heights[x + i, y + j]
            if np.isnan(disc).any():
                continue
            up, rough_m, slope = fit_plane(x * CELL_M, y * CELL_M, disc)
            if rough_m <= rules.rough_m and slope <= rules.slope:
                east, north = (self._corner + (np.array([i, j]) + 0.5) * CELL_M).tolist()
                return Place((east, north, up), rough_m, slope)
        return None

    def _list_centres(
        self, near: Floats, reach: int, within_m: float, rules: FlatRules, refused: list[Floats]
    ) -> list[tuple[int, int]]:
        """The cells on which a disc is within the grid, nearest first."""
        cells = np.arange(reach, CELLS - reach)
        i, j = (part.ravel() for part in np.meshgrid(cells, cells, indexing="ij"))
        centres = self._corner + (np.column_stack((i, j)) + 0.5) * CELL_M
        away2 = _distances2(centres, near)
        keep = away2 <= within_m * within_m
        for place in refused:
            keep &= _distances2(centres, place) > rules.clear_m * rules.clear_m
        order = np.argsort(away2[keep], kind="stable")
        return list(zip(i[keep][order].tolist(), j[keep][order].tolist(), strict=True))


def find_points(beams: Beams) -> Floats:
    """(k, 3): where the beams of a scan that returned have met something."""
    rows = np.flatnonzero(beams.distance_m > 0.0)
    return np.asarray(beams.origin + beams.direction[rows] * beams.distance_m[rows, None])


def fit_plane(x: Floats, y: Floats, z: Floats) -> tuple[float, float, float]:
    """Height at the centre, largest deviation and slope of the plane by least squares.

    (x, y) are symmetric about the centre and both axes, so the normal equations are diagonal.
    """
    up = math.fsum(z.tolist()) / len(z)
    along = math.fsum((x * z).tolist()) / math.fsum((x * x).tolist())
    across = math.fsum((y * z).tolist()) / math.fsum((y * y).tolist())
    rough = float(abs(z - up - along * x - across * y).max())
    return up, rough, math.sqrt(along * along + across * across)


def _distances2(places: Floats, other: Floats) -> Floats:
    """(n,): squared distances of places (n, 2) to another one."""
    return np.asarray(np.square(places[:, 0] - other[0]) + np.square(places[:, 1] - other[1]))


def _find_medians(number: np.ndarray[tuple[int, ...], np.dtype[np.int64]], heights: Floats) -> Floats:
    """(CELLS²,): the lower median of the heights in each cell; NaN for cells with fewer than `FEWEST`."""
    order = np.lexsort((heights, number))
    count = np.bincount(number, minlength=CELLS * CELLS)
    first = np.concatenate(([0], np.cumsum(count)[:-1]))
    medians = np.full(CELLS * CELLS, np.nan)
    some = count >= FEWEST
    medians[some] = heights[order][first[some] + (count[some] - 1) // 2]
    return medians
