"""Ray casting: the first surface that each ray meets, of the ground, buildings and aircraft.

Buildings are prisms with flat roofs, as in the city; their courtyards are open. The ground is the plane at height 0.
Surfaces have two sides: a ray that starts inside a building meets its wall or roof from within. The grid is crossed as
by Amanatides & Woo (Eurographics 1987). The result of a ray depends on nothing but the ray and the scene: not on other
rays, their order or their number.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.arrays import Floats
from skyrange.core.compiled import compiled
from skyrange.core.errors import InputError
from skyrange.optics.ray_index import RayIndex
from skyrange.optics.targets import NO_TARGETS, Targets

NONE: Final = 0
GROUND: Final = 1
BUILDING: Final = 2
AIRCRAFT: Final = 3
"""What a ray meets: `Hits.kind`."""
_UNIT_TOLERANCE: Final = 1e-9


class Rays(NamedTuple):
    """n rays. A sensor that moves during a scan gives each ray its own origin and time."""

    origin: Floats
    """(n, 3): east, north and up in m."""
    direction: Floats
    """(n, 3): unit vectors."""
    delay_s: Floats
    """(n,): time since the start of the scan, at which aircraft are where their velocity has brought them."""
    own: NDArray[np.int32]
    """(n,): the aircraft that carries the sensor, which the ray does not meet; -1 for none."""


class Hits(NamedTuple):
    """What n rays meet."""

    distance_m: Floats
    """(n,): infinite for none."""
    kind: NDArray[np.uint8]
    """(n,): `NONE`, `GROUND`, `BUILDING` or `AIRCRAFT`."""
    row: NDArray[np.int32]
    """(n,): row of the building in the city, or of the aircraft; -1 for others."""
    cosine: Floats
    """(n,): of the angle between ray and normal, 0 (grazing) to 1; 0 for none."""


def cast_rays(index: RayIndex, rays: Rays, reach_m: float, targets: Targets = NO_TARGETS) -> Hits:
    """The first surface that each ray meets within `reach_m`. `targets` were placed on the grid of `index`.

    Raises `InputError` for directions that are not unit vectors, for numbers that are not finite, and for targets of
    another grid.
    """
    count = len(rays.direction)
    given = (rays.origin.shape, rays.direction.shape, rays.delay_s.shape, rays.own.shape)
    if given != ((count, 3), (count, 3), (count,), (count,)):
        raise InputError.one("rays", "shapes", repr(given), "(n, 3), (n, 3), (n,) and (n,)")
    if not reach_m > 0.0:
        raise InputError.one("rays", "reach_m", repr(reach_m), "a positive number of metres")
    if len(targets.position) and len(targets.cell_start) != index.columns * index.rows + 1:
        raise InputError.one("rays", "targets", "placed on another grid", "targets that were placed on this index")
    hits = Hits(np.empty(count), np.empty(count, dtype=np.uint8), np.empty(count, dtype=np.int32), np.empty(count))
    wrong = _cast(index, targets, rays, reach_m, hits)
    if wrong >= 0:
        value = f"{rays.origin[wrong].tolist()} to {rays.direction[wrong].tolist()} after {rays.delay_s[wrong]} s"
        raise InputError.one("rays", f"ray {wrong}", value, "finite numbers and a direction of length 1")
    return hits


@compiled
def _cast(index: RayIndex, targets: Targets, rays: Rays, reach_m: float, hits: Hits) -> int:
    """Cast all rays; returns the first one that is no ray, otherwise -1.

    One long function on purpose: a call that passes arrays on costs more than the work it would do here.
    """
    cell_start, cell_top, cell_point, piece_start, piece_building, piece_inside, piece_span, walls = index[:8]
    west, south, side, columns, rows, top = index[8:]
    slab = max(top, targets.top)
    has_cells = columns > 0
    has_targets = targets.inside.shape[0] > 0
    for i in range(rays.direction.shape[0]):
        ox, oy, oz = rays.origin[i, 0], rays.origin[i, 1], rays.origin[i, 2]
        dx, dy, dz = rays.direction[i, 0], rays.direction[i, 1], rays.direction[i, 2]
        if not abs(dx * dx + dy * dy + dz * dz - 1.0) < _UNIT_TOLERANCE or not abs(ox + oy + oz) < math.inf:
            return i
        if not rays.delay_s[i] >= 0.0:
            return i
        best, kind, which, wall = reach_m, NONE, -1, -1
        if dz < 0.0 and oz >= 0.0:
            along = -oz / dz
            if along <= best:
                best, kind = along, GROUND
        for k in range(targets.beyond.shape[0]):
            j = targets.beyond[k]
            if j != rays.own[i]:
                along = _meet_cylinder(targets, j, ox, oy, oz, dx, dy, dz, rays.delay_s[i])
                if along < best or (along == best and kind != AIRCRAFT):
                    best, kind, which = along, AIRCRAFT, j
        # the part of the ray over the grid and below the highest roof
        begin, end = 0.0, best
        if not has_cells:
            end = -1.0
        if dz > 0.0:
            end = min(end, (slab - oz) / dz)
        elif oz > slab:
            begin = (slab - oz) / dz if dz < 0.0 else math.inf
        x, y = (ox - west) / side, (oy - south) / side
        wx, wy = dx / side, dy / side
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
        if begin <= end:
            column = min(max(math.floor(x + begin * wx), 0), columns - 1)
            row = min(max(math.floor(y + begin * wy), 0), rows - 1)
            east, north = (1 if wx > 0.0 else -1), (1 if wy > 0.0 else -1)
            next_x = next_y = each_x = each_y = math.inf
            if wx != 0.0:
                next_x, each_x = (column + (1.0 if wx > 0.0 else 0.0) - x) / wx, abs(1.0 / wx)
            if wy != 0.0:
                next_y, each_y = (row + (1.0 if wy > 0.0 else 0.0) - y) / wy, abs(1.0 / wy)
            way = begin
            while way <= best and 0 <= column < columns and 0 <= row < rows:
                leaving = min(next_x, next_y, end)
                cell = row * columns + column
                z_in, z_out = oz + way * dz, oz + leaving * dz
                lowest, highest = min(z_in, z_out), max(z_in, z_out)
                if cell_top[cell] >= lowest:
                    for p in range(cell_start[cell], cell_start[cell + 1]):
                        base, roof = piece_span[p, 0], piece_span[p, 1]
                        if roof < lowest or base > highest:
                            continue
                        for k in range(piece_start[p], piece_start[p + 1]):
                            px, py = walls[k, 0] - ox, walls[k, 1] - oy
                            qx, qy = walls[k, 2] - ox, walls[k, 3] - oy
                            one, two = dx * py - dy * px, dx * qy - dy * qx
                            if (one > 0.0) != (two > 0.0):  # its ends lie on both sides of the ray
                                along = (px * qy - py * qx) / (two - one)
                                if 0.0 <= along < best:
                                    z = oz + along * dz
                                    if base <= z <= roof:
                                        best, kind, which, wall = along, BUILDING, piece_building[p], k
                        for face in range(2):
                            level = roof if face == 0 else base
                            if not lowest <= level <= highest or dz == 0.0 or (face == 1 and base <= 0.0):
                                continue
                            along = (level - oz) / dz
                            if 0.0 <= along < best:
                                cx, cy = cell_point[cell, 0], cell_point[cell, 1]
                                ex, ey = ox + along * dx - cx, oy + along * dy - cy
                                inside = piece_inside[p]
                                for k in range(piece_start[p], piece_start[p + 1]):
                                    px, py = walls[k, 0] - cx, walls[k, 1] - cy
                                    qx, qy = walls[k, 2] - cx, walls[k, 3] - cy
                                    one, two = ex * py - ey * px, ex * qy - ey * qx
                                    if (one > 0.0) != (two > 0.0):
                                        share = (px * qy - py * qx) / (two - one)
                                        if 0.0 <= share < 1.0:
                                            inside = not inside
                                if inside:
                                    best, kind, which, wall = along, BUILDING, piece_building[p], -1
                if has_targets:
                    for k in range(targets.cell_start[cell], targets.cell_start[cell + 1]):
                        j = targets.inside[k]
                        if j != rays.own[i]:
                            along = _meet_cylinder(targets, j, ox, oy, oz, dx, dy, dz, rays.delay_s[i])
                            if along < best:
                                best, kind, which = along, AIRCRAFT, j
                if best <= leaving or leaving >= end:
                    break
                way = leaving
                if next_x < next_y:
                    next_x, column = next_x + each_x, column + east
                else:
                    next_y, row = next_y + each_y, row + north
        hits.kind[i] = kind
        hits.row[i] = which
        if kind == NONE:
            hits.distance_m[i], hits.cosine[i] = math.inf, 0.0
            continue
        hits.distance_m[i] = best
        cosine = abs(dz)
        if kind == BUILDING and wall >= 0:
            ex, ey = walls[wall, 2] - walls[wall, 0], walls[wall, 3] - walls[wall, 1]
            cosine = abs(dx * ey - dy * ex) / math.sqrt(ex * ex + ey * ey)
        elif kind == AIRCRAFT:
            cosine = _cylinder_cosine(
                targets, which, ox + best * dx, oy + best * dy, oz + best * dz, dx, dy, dz, rays.delay_s[i]
            )
        hits.cosine[i] = min(cosine, 1.0)
    return -1


@compiled
def _meet_cylinder(  # noqa: PLR0917
    targets: Targets, j: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, delay_s: float
) -> float:
    """The distance at which a ray meets an aircraft's cylinder, infinite for never; from within, that of its exit."""
    x = ox - (targets.position[j, 0] + delay_s * targets.velocity[j, 0])
    y = oy - (targets.position[j, 1] + delay_s * targets.velocity[j, 1])
    z = oz - (targets.position[j, 2] + delay_s * targets.velocity[j, 2])
    radius, height = targets.radius[j], targets.height[j]
    a = dx * dx + dy * dy
    enters, leaves = -math.inf, math.inf
    if a > 0.0:
        # from the point of the ray that is nearest to the axis: no small difference of large squares
        nearest = -(x * dx + y * dy) / a
        nx, ny = x + nearest * dx, y + nearest * dy
        rest = radius * radius - (nx * nx + ny * ny)
        if rest < 0.0:
            return math.inf
        half = math.sqrt(rest / a)
        enters, leaves = nearest - half, nearest + half
    elif x * x + y * y > radius * radius:
        return math.inf
    if dz != 0.0:
        one, two = -z / dz, (height - z) / dz
        enters, leaves = max(enters, min(one, two)), min(leaves, max(one, two))
    elif z < 0.0 or z > height:
        return math.inf
    if enters > leaves or leaves < 0.0:
        return math.inf
    return float(enters if enters >= 0.0 else leaves)


@compiled
def _cylinder_cosine(  # noqa: PLR0917
    targets: Targets, j: int, x: float, y: float, z: float, dx: float, dy: float, dz: float, delay_s: float
) -> float:
    """Cosine of incidence at a point of an aircraft's cylinder: of its side, or of its top or bottom if nearer."""
    rx = x - (targets.position[j, 0] + delay_s * targets.velocity[j, 0])
    ry = y - (targets.position[j, 1] + delay_s * targets.velocity[j, 1])
    rz = z - (targets.position[j, 2] + delay_s * targets.velocity[j, 2])
    across = math.sqrt(rx * rx + ry * ry)
    from_side = abs(across - targets.radius[j])
    from_end = min(abs(rz), abs(rz - targets.height[j]))
    if from_end < from_side or across == 0.0:
        return abs(dz)
    return float(abs(dx * rx + dy * ry) / across)
