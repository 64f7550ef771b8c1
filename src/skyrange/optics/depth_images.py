"""Depth images of a stereo camera, with the truth of each pixel.

The label of a pixel, which surface it shows, is for data sets. Not modelled: what a matcher of two images does at
edges, on surfaces without texture, in the dark, and where one camera sees what the other does not.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core import elementary
from skyrange.core.arrays import Floats
from skyrange.core.chance import uniform4
from skyrange.core.compiled import compiled
from skyrange.core.errors import InputError
from skyrange.optics.ray_casting import NONE, Hits
from skyrange.optics.returns import MAX_STEPS, Address
from skyrange.optics.scan_patterns import Firing
from skyrange.optics.sensor_models import DepthCameraModel

STREAM: Final = "optics.depth"


class DepthImage(NamedTuple):
    """One image, row by row from the top left."""

    steps: NDArray[np.uint16]
    """(height, width): depth along the axis in steps of the model's resolution, 0 for none."""
    kind: NDArray[np.uint8]
    """(height, width): truth (`Hits.kind`)."""
    row: NDArray[np.int32]
    """(height, width): truth (`Hits.row`)."""


def make_depth_image(model: DepthCameraModel, firing: Firing, hits: Hits, address: Address) -> DepthImage:
    """The depths of one image, of which `hits` has one ray for each pixel (`firing`).

    Raises `InputError` for another number of rays, and for a range that 16 bits do not hold.
    """
    grid = model.pattern
    count = grid.width * grid.height
    if len(hits.kind) != count:
        raise InputError.one(model.name, "hits", str(len(hits.kind)), f"{count}, one for each pixel")
    if model.reach_m > MAX_STEPS * model.resolution_m:
        raise InputError.one(
            model.name, "reach_m", repr(model.reach_m), f"at most {MAX_STEPS * model.resolution_m:g} m"
        )
    steps = np.zeros(count, dtype=np.uint16)
    limits = (model.near_m, model.reach_m, model.noise_m(1.0), model.resolution_m)
    _find(hits, firing.direction, limits, address.key(STREAM), np.int64(address.start_ns).view(np.uint64), steps)
    shape = (grid.height, grid.width)
    return DepthImage(steps.reshape(shape), hits.kind.reshape(shape), hits.row.reshape(shape))


@compiled
def _find(
    hits: Hits,
    direction: Floats,
    limits: tuple[float, float, float, float],
    key: tuple[np.uint64, np.uint64, np.uint64],
    start: np.uint64,
    steps: NDArray[np.uint16],
) -> None:
    near, reach, noise, resolution = limits
    for i in range(steps.shape[0]):
        if hits.kind[i] == NONE:
            continue
        depth = hits.distance_m[i] * direction[i, 0]
        u0, u1, _, _ = uniform4(key[0], key[1], key[2], start, np.uint64(i))
        normal = math.sqrt(-2.0 * elementary.log(1.0 - u0)) * elementary.cos(2.0 * math.pi * u1)
        measured = depth + noise * depth * depth * normal
        if near <= measured <= reach:
            steps[i] = np.uint16(math.floor(measured / resolution + 0.5))
