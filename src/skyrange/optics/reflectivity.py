"""Diffuse reflectivity of materials at 0.9 µm, and which surface has which.

All surfaces are Lambertian: they throw light back in all directions by the cosine of the angle to the normal. Glass,
water and polished metal are not, and a facade of glass is seen here as if it were masonry.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from skyrange.core.arrays import Floats


class Material(NamedTuple):
    """The reflectivity of a material, 0 to 1, and where the number is from."""

    reflectivity: float
    source: str


_TABLE: Final = "Wehr & Lohr, ISPRS J. Photogramm. Remote Sens. 54, 1999: typical reflectivities at 0.9 um"
MATERIALS: Final = {
    "concrete": Material(0.24, _TABLE),
    "asphalt": Material(0.17, _TABLE),
    "white masonry": Material(0.85, _TABLE),
    "limestone": Material(0.75, _TABLE),
    "deciduous trees": Material(0.60, _TABLE),
    "dry sand": Material(0.57, _TABLE),
    "rough wood": Material(0.25, _TABLE),
    "black neoprene": Material(0.05, _TABLE),
    "black rubber": Material(0.02, _TABLE),
    "aircraft": Material(0.10, "assumed: dark plastic and carbon fibre, twice black neoprene"),
    "bird": Material(0.30, "assumed: grey plumage"),
    "wire": Material(0.30, "assumed: weathered aluminium"),
}
"""By name."""


class Surfaces(NamedTuple):
    """Reflectivities of what rays meet."""

    ground: float
    building: Floats
    """(b,) by row of the city, or (1,) for all."""
    aircraft: Floats
    """(n,) by row of the targets, or (1,) for all."""


def make_surfaces(ground: str = "asphalt", building: str = "concrete", aircraft: str = "aircraft") -> Surfaces:
    """Surfaces of one material each, by name."""
    one = (np.array([MATERIALS[name].reflectivity]) for name in (building, aircraft))
    return Surfaces(MATERIALS[ground].reflectivity, *one)
