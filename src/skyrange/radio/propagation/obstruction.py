"""Obstruction by buildings: geometric lines of sight, and diffraction where a line is blocked.

The line is traced through the grid of `city.wall_index` cell by cell; buildings below it are skipped. On an
unobstructed line, a roof just below it still causes the loss of P.526's knife edge. On an obstructed line, the signal
arrives over the roofs and round both sides, each path as Bullington's single equivalent edge (ITU-R P.526-15 4.5.1;
its terrain correction, up to 10 dB, is left out), and the powers add (5.1, "finite-width screen"). A path round a side
counts only past one or two buildings, and only if both its legs are unobstructed.

Walls beside the line guide the signal (`street_canyon`). Along an unobstructed line they reduce the loss over open
ground, so that the result may be negative. Between two antennas in street canyons that do not see each other, the loss
is at most the median that P.1411-10 4.1.1 gives for streets without line of sight: it was measured, so it contains
diffraction, and the powers do not add.

Not modelled: single reflections, transmission through buildings, courtyards (taken as solid).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from skyrange.core import elementary, elementary_python
from skyrange.core.compiled import compiled
from skyrange.radio.propagation.obstacle_grid import Obstacles as Obstacles
from skyrange.radio.propagation.obstacle_grid import obstacle_index as obstacle_index
from skyrange.radio.propagation.obstacle_grid import start_traversal
from skyrange.radio.propagation.path_loss import CLEAR_NU, bullington_nu, knife_edge_db
from skyrange.radio.propagation.street_canyon import (
    UNKNOWN,
    guiding_gain_db,
    street_excess_by_place_db,
    street_excess_db,
)

ROOF_MARGIN_M: Final = 4.0
"""How far below a line a roof is considered: 0.78 of the Fresnel radius of 2 km at 2.4 GHz is 4.3 m, at 1 km 3.1 m."""
MIN_EDGE_DISTANCE_M: Final = 1.0
"""Edges count as at least this far from either antenna."""
MAX_BUILDINGS_ROUND: Final = 2
"""The most buildings in a row that a signal passes round the sides; past more of them it arrives
over the roofs only."""
BLOCKED: Final = math.inf
_LIMIT: Final = elementary_python.exp10(0.05 * (4.8 - 12.92))
_NEGLIGIBLE_DB: Final = 10.0  # a path with that much more loss than the one over the roofs adds less than half a dB
_SUM_DB: Final = 4.8  # three equal paths together are 4.8 dB above one of them


@compiled
def _inverse(way: float) -> float:
    """1 / way, and a large number for 0, so that the slab test gives the right result."""
    return 1.0 / way if abs(way) > 1e-9 else 1e9


class TraceResult(NamedTuple):
    """What a line meets: the steepest slopes from both ends over and round its obstacles, and the nearest roof below
    it.
    """

    blocking: int
    """How many buildings obstruct the line, as far as it was traced; with more than `MAX_BUILDINGS_ROUND` there is no
    path round the sides."""
    up_a: float
    up_b: float
    left_a: float
    left_b: float
    right_a: float
    right_b: float
    grazing_nu: float
    """ν of the roof that comes nearest to the line without obstructing it."""


@compiled
def trace_line(  # noqa: PLR0917
    obstacles: Obstacles,
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    wavelength: float,
    stop_threshold: float,
) -> TraceResult:
    """Trace a line from A to B until it is certainly blocked: until products of two slopes exceed `stop_threshold`.

    One long function on purpose: a call that passes arrays on costs more than the work it would do here.
    """
    box, edges, first, cells, inside, tops, _, west, south, side, columns, rows = obstacles
    dx, dy, dz = bx - ax, by - ay, bz - az
    distance = math.sqrt(dx * dx + dy * dy)
    grazing_nu = CLEAR_NU
    up_a = up_b = left_a = left_b = right_a = right_b = 0.0
    blocking = 0
    if columns == 0 or distance < 2.0 * MIN_EDGE_DISTANCE_M:
        return TraceResult(blocking, up_a, up_b, left_a, left_b, right_a, right_b, grazing_nu)
    per_x, per_y = _inverse(dx), _inverse(dy)
    last = before = first_cut = second_cut = -1
    column, row, east, north, next_x, next_y, each_x, each_y, way, end = start_traversal(
        west, south, side, columns, rows, ax, ay, dx, dy
    )
    while way < end and 0 <= column < columns and 0 <= row < rows:
        leaving = min(next_x, next_y, end)
        cell = row * columns + column
        lowest = az + min(way * dz, leaving * dz) - ROOF_MARGIN_M
        way = leaving
        if next_x < next_y:
            next_x, column = next_x + each_x, column + east
        else:
            next_y, row = next_y + each_y, row + north
        if tops[cell] < lowest:
            continue
        for k in range(cells[cell], cells[cell + 1]):
            b = inside[k]
            top = box[b, 5]
            if top < lowest or b in (last, before):
                continue
            last, before = b, last
            one, two = (box[b, 0] - ax) * per_x, (box[b, 2] - ax) * per_x
            low, high = max(0.0, min(one, two)), min(1.0, max(one, two))
            one, two = (box[b, 1] - ay) * per_y, (box[b, 3] - ay) * per_y
            low, high = max(low, min(one, two)), min(high, max(one, two))
            if not low <= high or top < az + min(low * dz, high * dz) - ROOF_MARGIN_M:
                continue
            enters, leaves = 2.0, -1.0
            for e in range(first[b], first[b + 1]):
                px, py, qx, qy = edges[e, 0] - ax, edges[e, 1] - ay, edges[e, 2] - ax, edges[e, 3] - ay
                one, two = dx * py - dy * px, dx * qy - dy * qx
                if (one > 0.0) != (two > 0.0):  # its ends lie on both sides of the line
                    along = (px * qy - py * qx) / (two - one)
                    if 0.0 <= along <= 1.0:
                        enters, leaves = min(enters, along), max(leaves, along)
            if leaves < 0.0 or az + max(enters * dz, leaves * dz) < box[b, 4]:
                continue  # beside it, or below it: a bridge between towers
            higher = False
            for turn in range(2):
                share = enters if turn == 0 else leaves
                x = min(max(share * distance, MIN_EDGE_DISTANCE_M), distance - MIN_EDGE_DISTANCE_M)
                over = top - (az + share * dz)
                up_a, up_b = max(up_a, over / x), max(up_b, over / (distance - x))
                if over > 0.0:
                    higher = True
                else:
                    grazing_nu = max(grazing_nu, over * math.sqrt(2.0 * distance / (wavelength * x * (distance - x))))
            if not higher:
                continue
            if b not in (first_cut, second_cut):
                blocking += 1
                first_cut, second_cut = b, first_cut
            if blocking > MAX_BUILDINGS_ROUND:
                if up_a * up_b > stop_threshold:
                    return TraceResult(blocking, up_a, up_b, left_a, left_b, right_a, right_b, grazing_nu)
                continue
            for e in range(first[b], first[b + 1]):
                px, py = edges[e, 0] - ax, edges[e, 1] - ay
                x = min(max((px * dx + py * dy) / distance, MIN_EDGE_DISTANCE_M), distance - MIN_EDGE_DISTANCE_M)
                aside = (dx * py - dy * px) / distance
                left_a, left_b = max(left_a, aside / x), max(left_b, aside / (distance - x))
                right_a, right_b = max(right_a, -aside / x), max(right_b, -aside / (distance - x))
            if up_a * up_b > stop_threshold and min(left_a * left_b, right_a * right_b) > stop_threshold:
                return TraceResult(blocking, up_a, up_b, left_a, left_b, right_a, right_b, grazing_nu)
    return TraceResult(blocking, up_a, up_b, left_a, left_b, right_a, right_b, grazing_nu)


@compiled
def has_line_of_sight(obstacles: Obstacles, ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> bool:  # noqa: PLR0917
    """Whether a line meets no building: the same decisions as in `trace_line`, without what they would cost."""
    box, edges, first, cells, inside, tops, _, west, south, side, columns, rows = obstacles
    dx, dy, dz = bx - ax, by - ay, bz - az
    if columns == 0 or dx * dx + dy * dy < 4.0 * MIN_EDGE_DISTANCE_M * MIN_EDGE_DISTANCE_M:
        return True
    per_x, per_y = _inverse(dx), _inverse(dy)
    last = -1
    column, row, east, north, next_x, next_y, each_x, each_y, way, end = start_traversal(
        west, south, side, columns, rows, ax, ay, dx, dy
    )
    while way < end and 0 <= column < columns and 0 <= row < rows:
        leaving = min(next_x, next_y, end)
        cell = row * columns + column
        lowest = az + min(way * dz, leaving * dz)
        way = leaving
        if next_x < next_y:
            next_x, column = next_x + each_x, column + east
        else:
            next_y, row = next_y + each_y, row + north
        if tops[cell] < lowest:
            continue
        for k in range(cells[cell], cells[cell + 1]):
            b = inside[k]
            top = box[b, 5]
            if top < lowest or b == last:
                continue
            last = b
            one, two = (box[b, 0] - ax) * per_x, (box[b, 2] - ax) * per_x
            low, high = max(0.0, min(one, two)), min(1.0, max(one, two))
            one, two = (box[b, 1] - ay) * per_y, (box[b, 3] - ay) * per_y
            low, high = max(low, min(one, two)), min(high, max(one, two))
            if not low <= high or top < az + min(low * dz, high * dz):
                continue
            enters, leaves = 2.0, -1.0
            for e in range(first[b], first[b + 1]):
                px, py, qx, qy = edges[e, 0] - ax, edges[e, 1] - ay, edges[e, 2] - ax, edges[e, 3] - ay
                one, two = dx * py - dy * px, dx * qy - dy * qx
                if (one > 0.0) != (two > 0.0):  # its ends lie on both sides of the line
                    along = (px * qy - py * qx) / (two - one)
                    if 0.0 <= along <= 1.0:
                        enters, leaves = min(enters, along), max(leaves, along)
            if leaves < 0.0 or az + max(enters * dz, leaves * dz) < box[b, 4]:
                continue
            if top > az + min(enters * dz, leaves * dz):
                return False
    return True


@compiled
def _side_path_db(  # noqa: PLR0917
    obstacles: Obstacles, a: float, b: float, side: float, ends: tuple[float, ...], distance: float, wavelength: float
) -> float:
    """Loss of the path round one side (+1 left, -1 right) if its legs are unobstructed; `BLOCKED` if not."""
    along = distance * b / (a + b)
    aside = a * along + 0.5  # half a metre off the corner, so that the legs clear the building
    ax, ay, az, dx, dy, dz = ends
    x = ax + (dx * along - side * dy * aside) / distance
    y = ay + (dy * along + side * dx * aside) / distance
    z = az + dz * along / distance
    if has_line_of_sight(obstacles, ax, ay, az, x, y, z) and has_line_of_sight(
        obstacles, x, y, z, ax + dx, ay + dy, az + dz
    ):
        return knife_edge_db(bullington_nu(a, b, distance, wavelength))
    return BLOCKED


@compiled
def obstruction_db(  # noqa: PLR0917
    obstacles: Obstacles,
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    wavelength: float,
    margin_db: float,
) -> float:
    """Loss by buildings between two positions, on top of `path_loss.open_ground_db`; `BLOCKED` if more than
    `margin_db`.

    0 without any building near the line, 0 to 6 dB with a roof close below it, more if the line is obstructed; down to
    minus `path_loss.ground_excess_db` along a street.
    """
    stop = stop_threshold(elementary.exp10(0.05 * margin_db), ax, ay, bx, by, wavelength)
    met = trace_line(obstacles, ax, ay, az, bx, by, bz, wavelength, stop)
    return traced_loss_db(obstacles, met, ax, ay, az, bx, by, bz, wavelength, margin_db, UNKNOWN)


@compiled
def stop_threshold(margin: float, ax: float, ay: float, bx: float, by: float, wavelength: float) -> float:
    """The product of two slopes at which `trace_line` may stop: from there on every path costs more than the margin.

    `margin` is a ratio of field strengths. J(ν) is at least 6.9 + 20·log10(2·(ν - 0.1)).
    """
    limit = 0.1 + _LIMIT * margin
    return (
        limit
        * limit
        * wavelength
        / (2.0 * max(math.sqrt((bx - ax) * (bx - ax) + (by - ay) * (by - ay)), MIN_EDGE_DISTANCE_M))
    )


@compiled
def traced_loss_db(  # noqa: PLR0917
    obstacles: Obstacles,
    met: TraceResult,
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    wavelength: float,
    margin_db: float,
    street_a: int,
) -> float:
    """The loss along a line that was traced; see `obstruction_db` and `street_excess_by_place_db`."""
    if met.blocking == 0:
        loss = knife_edge_db(met.grazing_nu) - guiding_gain_db(obstacles, ax, ay, az, bx, by, bz, wavelength)
        return float(loss) if loss <= margin_db else BLOCKED
    dx, dy, dz = bx - ax, by - ay, bz - az
    distance = math.sqrt(dx * dx + dy * dy)
    over = knife_edge_db(bullington_nu(met.up_a, met.up_b, distance, wavelength))
    left = right = BLOCKED
    if met.blocking <= MAX_BUILDINGS_ROUND:
        left = knife_edge_db(bullington_nu(met.left_a, met.left_b, distance, wavelength))
        right = knife_edge_db(bullington_nu(met.right_a, met.right_b, distance, wavelength))
    loss = BLOCKED
    if min(over, min(left, right)) <= margin_db + _SUM_DB:
        ends = (ax, ay, az, dx, dy, dz)
        power = elementary.exp10(-0.1 * over)
        if left <= over + _NEGLIGIBLE_DB and met.left_a * met.left_b > 0.0:
            power += elementary.exp10(
                -0.1 * _side_path_db(obstacles, met.left_a, met.left_b, 1.0, ends, distance, wavelength)
            )
        if right <= over + _NEGLIGIBLE_DB and met.right_a * met.right_b > 0.0:
            power += elementary.exp10(
                -0.1 * _side_path_db(obstacles, met.right_a, met.right_b, -1.0, ends, distance, wavelength)
            )
        loss = -10.0 * elementary.log10(power)
    if loss > margin_db:
        loss = BLOCKED
    both, one = street_excess_db(math.sqrt(distance * distance + dz * dz), az, bz, wavelength)
    limit = min(loss, margin_db)
    if min(both, one) < limit:
        street = street_excess_by_place_db(obstacles, ax, ay, az, bx, by, bz, both, one, street_a)
        if street < limit:
            loss = street
    return float(loss)
