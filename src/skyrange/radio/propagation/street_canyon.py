"""Street canyons: the walls beside a street, and what they change along it and round its corners.

Walls guide a signal. Along a street, Herring et al. (IEEE Trans. Antennas Propag. 58/1, 2010; 2.4 GHz, antennas on
the tops of vans, tens of metres to kilometres) measured a path loss exponent of 1.5 + 3.2·μ, from 2 to 5, where μ is
the share of the street's length that has a gap between buildings on either side. Here this exponent takes the place of
that of open ground, which is 4 beyond the breakpoint.

Without line of sight, diffraction alone makes the loss too large by tens of decibels, because walls reflect and scatter
the signal round corners and down into streets. For two antennas below the roofs, ITU-R P.1411-10 4.1.1 gives the median
that was measured in streets, whatever their heights; for one of them above, 3GPP TR 36.777 gives one by its height.

Walls are found by horizontal rays through the grid of the city. They count if they are higher than the ray, and if
those of both sides are together at most `MAX_WIDTH_M` apart.
"""

from __future__ import annotations

import math
from typing import Final

from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.radio.propagation.obstacle_grid import Obstacles, start_traversal
from skyrange.radio.propagation.path_loss import SPEED_OF_LIGHT_MPS, ground_excess_db, open_ground_db

MAX_WIDTH_M: Final = 50.0
"""The widest street: the default separation of building rows is 20 to 50 m (P.1411-12 4.4, after COST 231)."""
MIN_EXCESS_DB: Final = 6.0
"""The least loss round obstacles above that of an unobstructed line: that of an edge on the line (P.526-15, 4.1)."""
SAMPLES: Final = 32
"""Positions along a line at which its walls are looked for: the exponent is known to 3.2/32."""
OPEN_EXPONENT: Final = 4.0
"""That of `path_loss.open_ground_db` beyond the breakpoint."""
FREE_EXPONENT: Final = 2.0
AERIAL_HEIGHT_M: Final = 22.5
"""From this height on, TR 36.777 table B-2 has a model of aerial users of its own."""
UNKNOWN: Final = -1
_ALPHA: Final = 4.0
_BETA: Final = 10.2
_GAMMA: Final = 2.36
_DIAGONAL: Final = math.sqrt(0.5)


@compiled
def street_loss_db(distance_m: float, wavelength: float) -> float:
    """Median loss between two antennas in streets without line of sight, by their distance in space.

    ITU-R P.1411-10 4.1.1, site-general, table 4, NLoS in urban high-rise: 10·4.00·log10(d/m) + 10.2 +
    10·2.36·log10(f/GHz), for 0.8 to 38 GHz and 30 to 715 m.
    """
    frequency_ghz = SPEED_OF_LIGHT_MPS / wavelength * 1e-9
    return (
        10.0 * _ALPHA * elementary.log10(max(distance_m, 1.0)) + _BETA + 10.0 * _GAMMA * elementary.log10(frequency_ghz)
    )


@compiled
def aerial_loss_db(distance_m: float, height_m: float, wavelength: float) -> float:
    """Median loss between an antenna in a street and one above, without line of sight, by their distance in space.

    3GPP TR 36.777 table B-2, UMi-AV, NLOS: 32.4 + (43.2 - 7.6·log10(h/m))·log10(d/m) + 20·log10(f/GHz); h is the height
    of the upper antenna, 22.5 to 300 m. ITU-R P.1411-12 4.2.1 has 43.9·log10(d/m) - 6.27 + 23·log10(f/GHz) for all
    heights: at 400 m and h = 60 m, both are within 1 dB.
    """
    frequency_ghz = SPEED_OF_LIGHT_MPS / wavelength * 1e-9
    slope = 43.2 - 7.6 * elementary.log10(max(height_m, AERIAL_HEIGHT_M))
    return 32.4 + slope * elementary.log10(max(distance_m, 1.0)) + 20.0 * elementary.log10(frequency_ghz)


@compiled
def has_walls_beside(obstacles: Obstacles, x: float, y: float, z: float, east: float, north: float) -> bool:
    """Whether there are walls on both sides, higher than z and together at most `MAX_WIDTH_M` apart.

    They are looked for along the direction (east, north), of length 1, and against it. All lengths are in metres.
    """
    box, edges, first, cells, inside, tops, _, west, south, side, columns, rows = obstacles
    reach = MAX_WIDTH_M
    for turn in range(2):
        dx, dy = (east * reach, north * reach) if turn == 0 else (-east * reach, -north * reach)
        nearest = 2.0
        column, row, to_east, to_north, next_x, next_y, each_x, each_y, way, end = start_traversal(
            west, south, side, columns, rows, x, y, dx, dy
        )
        while way < end and way < nearest and 0 <= column < columns and 0 <= row < rows:
            cell = row * columns + column
            way = min(next_x, next_y, end)
            if next_x < next_y:
                next_x, column = next_x + each_x, column + to_east
            else:
                next_y, row = next_y + each_y, row + to_north
            if tops[cell] <= z:
                continue
            for k in range(cells[cell], cells[cell + 1]):
                b = inside[k]
                if box[b, 5] <= z or box[b, 4] > z:
                    continue
                if box[b, 0] > x + max(dx, 0.0) or box[b, 2] < x + min(dx, 0.0):
                    continue
                if box[b, 1] > y + max(dy, 0.0) or box[b, 3] < y + min(dy, 0.0):
                    continue
                for e in range(first[b], first[b + 1]):
                    px, py, qx, qy = edges[e, 0] - x, edges[e, 1] - y, edges[e, 2] - x, edges[e, 3] - y
                    one, two = dx * py - dy * px, dx * qy - dy * qx
                    if (one > 0.0) != (two > 0.0):  # its ends lie on both sides of the ray's line
                        along = (px * qy - py * qx) / (two - one)
                        if 0.0 <= along <= 1.0:
                            nearest = min(nearest, along)
        if nearest > 1.0:
            return False
        reach -= nearest * reach
    return True


@compiled
def in_street_canyon(obstacles: Obstacles, x: float, y: float, z: float) -> bool:
    """Whether an antenna is below the roofs of both sides of a street of at most `MAX_WIDTH_M`, in any of four
    orientations.
    """
    column, row = math.floor((x - obstacles.west) / obstacles.side), math.floor((y - obstacles.south) / obstacles.side)
    if not (0 <= column < obstacles.columns and 0 <= row < obstacles.rows):
        return False  # the outermost cells are empty, so nothing encloses what is outside
    cell = row * obstacles.columns + column
    return (
        (z < obstacles.enclosure[cell, 0] and has_walls_beside(obstacles, x, y, z, 1.0, 0.0))
        or (z < obstacles.enclosure[cell, 1] and has_walls_beside(obstacles, x, y, z, 0.0, 1.0))
        or (z < obstacles.enclosure[cell, 2] and has_walls_beside(obstacles, x, y, z, _DIAGONAL, _DIAGONAL))
        or (z < obstacles.enclosure[cell, 3] and has_walls_beside(obstacles, x, y, z, _DIAGONAL, -_DIAGONAL))
    )


@compiled
def gap_share(obstacles: Obstacles, ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> float:  # noqa: PLR0917
    """Share of a line at which a wall higher than it is missing on one side or the other.

    Rays at right angles to the line, at evenly spaced positions; the same from both ends, to the bit.
    """
    if obstacles.columns == 0:
        return 1.0
    if (bx, by) < (ax, ay):
        ax, ay, az, bx, by, bz = bx, by, bz, ax, ay, az
    dx, dy, dz = bx - ax, by - ay, bz - az
    length = math.sqrt(dx * dx + dy * dy)
    if length <= 0.0:
        return 1.0
    gaps = 0
    for k in range(SAMPLES):
        share = (k + 0.5) / SAMPLES
        x, y, z = ax + share * dx, ay + share * dy, az + share * dz
        if not has_walls_beside(obstacles, x, y, z, -dy / length, dx / length):
            gaps += 1
    return gaps / SAMPLES


@compiled
def street_exponent(gap: float) -> float:
    """Path loss exponent along a street whose share `gap` of the length has a gap between buildings on either side.

    Herring et al. 2010: 1.5 + 3.2·μ; here at least that of free space and at most that of open ground.
    """
    return min(max(1.5 + 3.2 * gap, FREE_EXPONENT), OPEN_EXPONENT)


@compiled
def guiding_gain_db(  # noqa: PLR0917
    obstacles: Obstacles, ax: float, ay: float, az: float, bx: float, by: float, bz: float, wavelength: float
) -> float:
    """What the walls of a street take off the loss over open ground between two antennas in sight of each other.

    0 up to the breakpoint, and at most `ground_excess_db`: a street is at best free space.
    """
    dx, dy, dz = bx - ax, by - ay, bz - az
    excess = ground_excess_db(math.sqrt(dx * dx + dy * dy + dz * dz), az, bz, wavelength)
    if excess <= 0.0:
        return 0.0
    exponent = street_exponent(gap_share(obstacles, ax, ay, az, bx, by, bz))
    return excess * (OPEN_EXPONENT - exponent) / (OPEN_EXPONENT - FREE_EXPONENT)


@compiled
def street_excess_db(distance_m: float, az: float, bz: float, wavelength: float) -> tuple[float, float]:
    """Measured median loss without line of sight above that of open ground: with both antennas in streets, with one.

    At least `MIN_EXCESS_DB`; infinite with one in a street if the other one is below `AERIAL_HEIGHT_M`. Scalars only,
    because it is called for every obstructed line.
    """
    ground = open_ground_db(distance_m, az, bz, wavelength)
    both = max(street_loss_db(distance_m, wavelength) - ground, MIN_EXCESS_DB)
    upper = max(az, bz)
    if upper < AERIAL_HEIGHT_M:
        return both, math.inf
    return both, max(aerial_loss_db(distance_m, upper, wavelength) - ground, MIN_EXCESS_DB)


@compiled
def street_excess_by_place_db(  # noqa: PLR0917
    obstacles: Obstacles, ax: float, ay: float, az: float, bx: float, by: float, bz: float, both: float, one: float,
    street_a: int,
) -> float:  # fmt: skip
    """Which loss of `street_excess_db` applies at two positions; infinite unless the lower antenna is in a street.

    `street_a` is what `in_street_canyon` says of A, or `UNKNOWN`.
    """
    if (bz, bx, by) < (az, ax, ay):
        if not in_street_canyon(obstacles, bx, by, bz):
            return math.inf
        upper = in_street_canyon(obstacles, ax, ay, az) if street_a == UNKNOWN else street_a == 1
    else:
        if street_a == 0 or (street_a == UNKNOWN and not in_street_canyon(obstacles, ax, ay, az)):
            return math.inf
        upper = in_street_canyon(obstacles, bx, by, bz)
    return both if upper else one
