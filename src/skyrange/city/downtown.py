"""Generated downtown: a grid of blocks with streets between them and buildings on them.

Each building's footprint and height are addressed by its position in the grid, so a larger grid of the same seed
contains the smaller one's buildings at the same positions.
"""

from __future__ import annotations

import math

import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError, Problem

_STREAM = "city.downtown"
_HEIGHT_M = (20.0, 90.0)
_STREET_M = 24.0
_BLOCK_M = 72.0
_MIN_FILL = 0.6  # least share of its half-block that a building fills


def downtown_grid(
    blocks: tuple[int, int] = (8, 6),
    height_m: tuple[float, float] = _HEIGHT_M,
    seed: int = 0,
    street_m: float = _STREET_M,
    block_m: float = _BLOCK_M,
) -> City:
    """A downtown of `blocks` (east, north) square blocks centred on the origin, with two by two buildings on each.

    Heights lie in `height_m`, with many low and few high buildings (a uniform number squared). Streets of `street_m`
    run between the blocks and cross at the origin if both counts are even. Raises `InputError` for invalid arguments.
    """
    problems = []
    if min(blocks) < 1:
        problems.append(Problem("blocks", repr(blocks), "at least one block each way"))
    if not 0.0 < height_m[0] <= height_m[1] < math.inf:
        problems.append(Problem("height_m", repr(height_m), "a positive lowest and a highest height in metres"))
    for name, value in (("street_m", street_m), ("block_m", block_m)):
        if not 0.0 < value < math.inf:
            problems.append(Problem(name, repr(value), "a positive number of metres"))
    if problems:
        raise InputError("downtown", problems)
    chance = Chance(seed)
    pitch_m = block_m + street_m
    half_m = 0.5 * block_m
    low_m, high_m = height_m
    buildings = []
    for column in range(blocks[0]):
        for row in range(blocks[1]):
            west_m = (column - 0.5 * blocks[0]) * pitch_m + 0.5 * street_m
            south_m = (row - 0.5 * blocks[1]) * pitch_m + 0.5 * street_m
            for quarter in range(4):
                who = (column << 34) | (row << 2) | quarter
                tall, wide, deep, _ = chance.uniform4(_STREAM, who, 0)
                width_m = half_m * (_MIN_FILL + (1.0 - _MIN_FILL) * wide)
                depth_m = half_m * (_MIN_FILL + (1.0 - _MIN_FILL) * deep)
                # Buildings extend to the street; the space they leave free is the block's courtyard.
                left_m = west_m if quarter % 2 == 0 else west_m + block_m - width_m
                below_m = south_m if quarter < 2 else south_m + block_m - depth_m
                shape = shapely.box(left_m, below_m, left_m + width_m, below_m + depth_m)
                top_m = round(low_m + (high_m - low_m) * tall * tall, 1)
                buildings.append(Building(f"{column}-{row}-{quarter}", top_m, shape))
    return City(buildings, f"downtown_grid {blocks[0]}x{blocks[1]} seed {seed}{_describe(height_m, street_m, block_m)}")


def _describe(height_m: tuple[float, float], street_m: float, block_m: float) -> str:
    """What tells a downtown from others of its size and seed: the measures that are not the default ones."""
    shape = "" if street_m == _STREET_M else f" streets {street_m:g} m"
    shape += "" if block_m == _BLOCK_M else f" blocks {block_m:g} m"
    return shape + ("" if tuple(height_m) == _HEIGHT_M else f" heights {height_m[0]:g} to {height_m[1]:g} m")
