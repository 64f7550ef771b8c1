"""Places of transmitters and receivers over a city: in streets, on roofs, and in flight."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City

Floats = NDArray[np.float64]

CLASSES: Final = ("street", "roof", "flight")
STREET_M: Final = 1.5
"""Height of a phone in a hand, in metres; 3GPP TR 38.901 table 7.2-1 has the same for UMi."""
ABOVE_ROOF_M: Final = 2.0
FLIGHT_M: Final = (30.0, 120.0)
"""Heights of flight in metres above the ground; 14 CFR 107.51 permits 122 m."""


class Places(NamedTuple):
    """n places."""

    enu_m: Floats
    """(n, 3)"""
    kind: NDArray[np.int64]
    """(n,) rows of `CLASSES`."""


def draw_places(city: City, count: int, kind: str, rng: np.random.Generator) -> Floats:
    """`count` places of a class, (count, 3) metres: outside of buildings, or on a roof. Evenly over the city's bounds,
    without its outer tenth; over roofs evenly by building.
    """
    west, south, east, north = city.bounds
    margin_x, margin_y = 0.1 * (east - west), 0.1 * (north - south)
    found: list[tuple[float, float, float]] = []
    while len(found) < count:
        if kind == "roof":
            building = city.buildings[int(rng.integers(len(city.buildings)))]
            point = building.shape.representative_point()
            x, y, z = float(point.x), float(point.y), building.height_m + ABOVE_ROOF_M
        else:
            x = float(rng.uniform(west + margin_x, east - margin_x))
            y = float(rng.uniform(south + margin_y, north - margin_y))
            z = STREET_M if kind == "street" else float(rng.uniform(*FLIGHT_M))
        if city.inside(x, y, z) is None:
            found.append((x, y, z))
    return np.array(found)


def draw_all(city: City, count: int, rng: np.random.Generator) -> Places:
    """`count` places of each class."""
    parts = [draw_places(city, count, kind, rng) for kind in CLASSES]
    return Places(np.concatenate(parts), np.repeat(np.arange(len(CLASSES)), count))
