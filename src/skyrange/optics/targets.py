"""Aircraft as rays meet them: upright cylinders that move while a scan lasts, and where on the grid they are.

The cylinder is that of collisions (`world.collision.response`): from the bottom of the gear to the top, as wide as the
propeller tips reach. It is the outline; a caller that knows how much of it is solid gives narrower ones.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.arrays import Floats
from skyrange.core.compiled import compiled
from skyrange.core.errors import InputError
from skyrange.optics.ray_index import RayIndex


class Targets(NamedTuple):
    """n aircraft during one scan, and the cells of a `RayIndex` that they are in."""

    position: Floats
    """(n, 3): centre of the bottom at the start of the scan, east, north and up in m."""
    velocity: Floats
    """(n, 3): in m/s, constant during the scan."""
    radius: Floats
    """(n,) in m."""
    height: Floats
    """(n,) in m."""
    cell_start: NDArray[np.int64]
    """(c + 1,): start of each cell's aircraft in `inside`; one zero without cells."""
    inside: NDArray[np.int32]
    beyond: NDArray[np.int32]
    """Aircraft that are at some time during the scan not within the grid: every ray tests them."""
    top: float
    """The greatest height that one of `inside` reaches, minus infinity without any."""


def place_targets(
    index: RayIndex, position: Floats, velocity: Floats, radius: Floats, height: Floats, *, during_s: float = 0.0
) -> Targets:
    """Place aircraft on the grid of `index` for a scan that lasts `during_s`; the arrays are those of `Targets`.

    Raises `InputError` for arrays of other shapes, and for numbers that are not finite or not positive.
    """
    count = len(position)
    shapes = {"position": (count, 3), "velocity": (count, 3), "radius": (count,), "height": (count,)}
    arrays = {"position": position, "velocity": velocity, "radius": radius, "height": height}
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise InputError.one("targets", name, f"shape {arrays[name].shape}", f"shape {shape}")
        if not np.isfinite(arrays[name]).all():
            raise InputError.one("targets", name, "a number that is not finite", "finite numbers")
    for name in ("radius", "height"):
        if count and not arrays[name].min() > 0.0:
            raise InputError.one("targets", name, repr(float(arrays[name].min())), "positive metres")
    if not 0.0 <= during_s < math.inf:
        raise InputError.one("targets", "during_s", repr(during_s), "0 or more seconds")
    arrays = {name: np.ascontiguousarray(array, dtype=np.float64) for name, array in arrays.items()}
    swept = _sweep(arrays["position"], arrays["velocity"], arrays["radius"], arrays["height"], during_s)
    listed = _list_in_cells(swept, index.west, index.south, index.side, index.columns, index.rows)
    return Targets(arrays["position"], arrays["velocity"], arrays["radius"], arrays["height"], *listed)


NO_TARGETS = Targets(
    np.empty((0, 3)),
    np.empty((0, 3)),
    np.empty(0),
    np.empty(0),
    np.zeros(1, dtype=np.int64),
    np.empty(0, dtype=np.int32),
    np.empty(0, dtype=np.int32),
    -math.inf,
)
"""No aircraft at all."""


def _sweep(position: Floats, velocity: Floats, radius: Floats, height: Floats, during_s: float) -> Floats:
    """(n, 5): west, south, east and north edge, and top, of what each aircraft occupies during the scan."""
    end = position + during_s * velocity
    low, high = np.minimum(position, end), np.maximum(position, end)
    return np.ascontiguousarray(
        np.column_stack(
            [low[:, 0] - radius, low[:, 1] - radius, high[:, 0] + radius, high[:, 1] + radius, high[:, 2] + height]
        )
    )


@compiled
def _list_in_cells(
    swept: Floats, west: float, south: float, side: float, columns: int, rows: int
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32], float]:
    """Each cell's aircraft, in ascending order; those that are not within the grid; the highest top of the others."""
    cells = columns * rows
    start = np.zeros(cells + 1, dtype=np.int64)
    inside = np.empty(0, dtype=np.int32)
    beyond = np.empty(swept.shape[0], dtype=np.int32)
    outside = 0
    top = -math.inf
    slack = 1e-6  # as of walls: rounding loses no aircraft at the edge of a cell
    for turn in range(2):
        for i in range(swept.shape[0] - 1, -1, -1):
            column0, column1 = (
                math.floor((swept[i, 0] - slack - west) / side),
                math.floor((swept[i, 2] + slack - west) / side),
            )
            row0, row1 = (
                math.floor((swept[i, 1] - slack - south) / side),
                math.floor((swept[i, 3] + slack - south) / side),
            )
            if column0 < 0 or row0 < 0 or column1 >= columns or row1 >= rows:
                if turn == 0:
                    beyond[swept.shape[0] - 1 - outside] = i
                    outside += 1
                continue
            top = max(top, swept[i, 4])
            for row in range(int(row0), int(row1) + 1):
                for column in range(int(column0), int(column1) + 1):
                    cell = row * columns + column
                    if turn == 0:
                        start[cell] += 1
                    else:
                        start[cell] -= 1
                        inside[start[cell]] = i
        if turn == 0:  # each start stands at its cell's end and moves down while the cell is filled
            for cell in range(cells):
                start[cell + 1] += start[cell]
            inside = np.empty(start[cells], dtype=np.int32)
    return start, inside, beyond[swept.shape[0] - outside :].copy(), top
