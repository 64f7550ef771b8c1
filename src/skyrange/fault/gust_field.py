"""Discrete gust: a front of moving air that passes over the fleet, with the shape of half a cosine.

MIL-F-8785C, 3.7.1.3: at a distance x into the gust the air moves at 0 before it (x < 0), at V/2·(1 - cos(π·x/d)) in its
rise of the length d, and at V behind. Here it falls again in the same length, after a part in which it is constant;
without that part it is the pulse of the gust load conditions of large aeroplanes, 14 CFR 25.341(a)(2).

The gust is a field that is carried along unchanged (Taylor's frozen turbulence, "The Spectrum of Turbulence",
Proc. R. Soc. A 164, 1938), so x is the way of its front since the start less the place of the aircraft along its
course. An aircraft that flies against it meets it sooner and faster.
"""

from __future__ import annotations

import numpy as np

from skyrange.contracts.components import Floats
from skyrange.core.compiled import compiled


@compiled
def find_shares(
    position_enu_m: Floats, at_east_m: float, at_north_m: float, east: float, north: float, way_m: float,
    length_m: float, hold_m: float, radius_m: float, share: Floats,
) -> bool:  # fmt: skip
    """Write the gust's share (n,) of its full speed at each place (n, 3); returns whether any is not 0.

    `east` and `north` are its course, `way_m` is the way of its front since the start. Beyond `radius_m` from where it
    started it fades out within `length_m`.
    """
    felt = False
    for row in range(len(share)):
        x, y = position_enu_m[row, 0] - at_east_m, position_enu_m[row, 1] - at_north_m
        into_m = way_m - (x * east + y * north)
        share[row] = rise_to(min(into_m, 2.0 * length_m + hold_m - into_m) / length_m)
        if radius_m < np.inf:
            share[row] *= rise_to((radius_m + length_m - np.hypot(x, y)) / length_m)
        felt = felt or share[row] > 0.0
    return felt


@compiled
def rise_to(part: float) -> float:
    """Half a cosine, from 0 at 0 to 1 at 1."""
    return float(0.5 * (1.0 - np.cos(np.pi * min(max(part, 0.0), 1.0))))
