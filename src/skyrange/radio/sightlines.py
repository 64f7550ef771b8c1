"""What do the buildings between two antennas cost? Geometric sight lines, and diffraction where there is none.

The grid of `city.walls` is the index: a cell's list holds every building within 20 m of it, so a look at each 40 m of a
path misses none. Where nothing stands in the way, a roof just below the line still costs what P.526's knife edge says.
Where something does, the signal comes over the roofs and round both sides, each way as Bullington's one equivalent edge
(ITU-R P.526-15 4.5.1; its addition for terrain, up to 10 dB, is left out), and powers add (5.1, "finite-width screen").
A way round a side counts only if both its legs are free of other buildings.

Not modelled: walls just beside a free line, reflections, what goes through buildings, courtyards (taken as solid).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.city.walls import MARGIN_M, NO_WALLS, Walls, cell_at
from skyrange.core.compiled import kernel
from skyrange.radio.propagation import NO_EDGE, bullington_nu, edge_db

STRIDE_M: Final = 2.0 * MARGIN_M
NEAR_M: Final = 4.0
"""How far below a line a roof may matter: 0.78 of the Fresnel radius of 2 km at 2.4 GHz is 4.3 m, at 1 km 3.1 m."""
END_M: Final = 1.0
"""Edges count as at least this far from either antenna."""
BEYOND: Final = math.inf
_SUM_DB: Final = 4.8  # three equal ways together are 4.8 dB above one of them


class Skyline(NamedTuple):
    """A city's walls, and the highest roof in each cell's list."""

    walls: Walls
    tops: NDArray[np.float64]


def skyline(walls: Walls = NO_WALLS) -> Skyline:
    """The index of some walls."""
    counts = np.diff(walls.cells)
    tops = np.full(len(counts), -np.inf)
    full = np.flatnonzero(counts)
    if len(full):
        tops[full] = np.maximum.reduceat(walls.box[walls.near, 5], walls.cells[:-1][full])
    return Skyline(walls, tops)


@kernel
def _crossing(
    walls: Walls, b: int, ax: float, ay: float, az: float, dx: float, dy: float, dz: float
) -> tuple[float, float]:
    """Where (shares of the way) a path enters and leaves a footprint at heights that matter; (2, -1) if it does not."""
    low, high = 0.0, 1.0
    for axis in range(2):
        start, way = (ax, dx) if axis == 0 else (ay, dy)
        least, most = walls.box[b, axis], walls.box[b, axis + 2]
        if abs(way) < 1e-9:
            if start < least or start > most:
                return 2.0, -1.0
        else:
            one, two = (least - start) / way, (most - start) / way
            low, high = max(low, min(one, two)), min(high, max(one, two))
    if low > high:
        return 2.0, -1.0
    lowest, highest = az + min(low * dz, high * dz), az + max(low * dz, high * dz)
    if walls.box[b, 5] < lowest - NEAR_M or walls.box[b, 4] > highest:
        return 2.0, -1.0
    enters, leaves = 2.0, -1.0
    for k in range(walls.first[b], walls.first[b + 1]):
        px, py = walls.edges[k, 0] - ax, walls.edges[k, 1] - ay
        ex, ey = walls.edges[k, 2] - ax - px, walls.edges[k, 3] - ay - py
        cross = dx * ey - dy * ex
        if cross == 0.0:
            continue
        along, aside = (px * ey - py * ex) / cross, (px * dy - py * dx) / cross
        if 0.0 <= along <= 1.0 and 0.0 <= aside <= 1.0:
            enters, leaves = min(enters, along), max(leaves, along)
    if leaves >= 0.0:
        under = az + max(enters * dz, leaves * dz) < walls.box[b, 4]
        if under:
            return 2.0, -1.0
    return enters, leaves


@kernel
def clear(sky: Skyline, ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> bool:
    """Whether a path meets no building."""
    walls = sky.walls
    dx, dy, dz = bx - ax, by - ay, bz - az
    pieces = int(max(abs(dx), abs(dy)) / STRIDE_M) + 1
    for piece in range(pieces):
        cell = cell_at(walls, ax + (piece + 0.5) / pieces * dx, ay + (piece + 0.5) / pieces * dy)
        lowest = az + min(piece * dz, (piece + 1) * dz) / pieces
        if cell < 0 or sky.tops[cell] <= lowest:
            continue
        for k in range(walls.cells[cell], walls.cells[cell + 1]):
            b = walls.near[k]
            if walls.box[b, 5] <= lowest:
                continue
            enters, leaves = _crossing(walls, b, ax, ay, az, dx, dy, dz)
            if leaves >= 0.0 and walls.box[b, 5] > az + min(enters * dz, leaves * dz):
                return False
    return True


@kernel
def _round_db(
    sky: Skyline, a: float, b: float, side: float, ends: tuple[float, ...], distance: float, wavelength: float
) -> float:
    """Loss of the way round one side (+1 left, -1 right), if its legs are clear; `BEYOND` if not."""
    along = distance * b / (a + b)
    aside = a * along + 0.5  # half a metre off the corner, so that the legs do not touch what they go round
    ax, ay, az, dx, dy, dz = ends
    x = ax + (dx * along - side * dy * aside) / distance
    y = ay + (dy * along + side * dx * aside) / distance
    z = az + dz * along / distance
    if clear(sky, ax, ay, az, x, y, z) and clear(sky, x, y, z, ax + dx, ay + dy, az + dz):
        return edge_db(bullington_nu(a, b, distance, wavelength))
    return BEYOND


@kernel
def obstruction_db(
    sky: Skyline, ax: float, ay: float, az: float, bx: float, by: float, bz: float, wavelength: float, margin_db: float
) -> float:
    """Loss by buildings between two places, on top of `propagation.open_db`; `BEYOND` if more than `margin_db`.

    0 without any near the line, 0 to 6 dB with a roof close below it, more where the line is cut.
    """
    walls = sky.walls
    dx, dy, dz = bx - ax, by - ay, bz - az
    distance = math.sqrt(dx * dx + dy * dy)
    if walls.columns == 0 or distance < 2.0 * END_M:
        return 0.0
    graze = NO_EDGE
    up_a = up_b = left_a = left_b = right_a = right_b = 0.0
    cut = False
    pieces = int(max(abs(dx), abs(dy)) / STRIDE_M) + 1
    for piece in range(pieces):
        cell = cell_at(walls, ax + (piece + 0.5) / pieces * dx, ay + (piece + 0.5) / pieces * dy)
        lowest = az + min(piece * dz, (piece + 1) * dz) / pieces
        if cell < 0 or sky.tops[cell] < lowest - NEAR_M:
            continue
        for k in range(walls.cells[cell], walls.cells[cell + 1]):
            b = walls.near[k]
            top = walls.box[b, 5]
            if top < lowest - NEAR_M:
                continue
            enters, leaves = _crossing(walls, b, ax, ay, az, dx, dy, dz)
            if leaves < 0.0:
                continue
            higher = False
            for share in (enters, leaves):
                x = min(max(share * distance, END_M), distance - END_M)
                over = top - (az + share * dz)
                up_a, up_b = max(up_a, over / x), max(up_b, over / (distance - x))
                if over > 0.0:
                    higher = True
                else:
                    graze = max(graze, over * math.sqrt(2.0 * distance / (wavelength * x * (distance - x))))
            if not higher:
                continue
            cut = True
            for e in range(walls.first[b], walls.first[b + 1]):
                px, py = walls.edges[e, 0] - ax, walls.edges[e, 1] - ay
                x = min(max((px * dx + py * dy) / distance, END_M), distance - END_M)
                aside = (dx * py - dy * px) / distance
                left_a, left_b = max(left_a, aside / x), max(left_b, aside / (distance - x))
                right_a, right_b = max(right_a, -aside / x), max(right_b, -aside / (distance - x))
            least = min(up_a * up_b, min(left_a * left_b, right_a * right_b))
            if edge_db(math.sqrt(2.0 * distance * least / wavelength)) > margin_db + _SUM_DB:
                return BEYOND
    if not cut:
        loss = edge_db(graze)
        return loss if loss <= margin_db else BEYOND
    ends = (ax, ay, az, dx, dy, dz)
    power = 10.0 ** (-0.1 * edge_db(bullington_nu(up_a, up_b, distance, wavelength)))
    for turn in range(2):
        a, b_, side = (left_a, left_b, 1.0) if turn == 0 else (right_a, right_b, -1.0)
        if a > 0.0 and b_ > 0.0 and edge_db(bullington_nu(a, b_, distance, wavelength)) <= margin_db + _SUM_DB:
            power += 10.0 ** (-0.1 * _round_db(sky, a, b_, side, ends, distance, wavelength))
    loss = -10.0 * math.log10(power)
    return loss if loss <= margin_db else BEYOND
