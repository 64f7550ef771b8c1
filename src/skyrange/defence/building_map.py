"""The map of buildings that a defence has: that of the world, or one with errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import shapely

from skyrange.city.city import City
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64

_STREAM: Final = "defence.map"


def map_with_errors(city: City | None, shift_m: tuple[float, float], missing: float, chance: Chance) -> City | None:
    """The city with all footprints moved by `shift_m`, east and north in metres, and without a share of its buildings.

    Which are missing depends on their ids and the seed. `None` where there is no building (left).
    """
    if city is None or (shift_m == (0.0, 0.0) and missing == 0.0):
        return city
    kept = [one for one in city.buildings if chance.uniform4(_STREAM, hash64(one.id), 0, 0)[0] >= missing]
    moved = [replace(one, shape=shapely.transform(one.shape, lambda points: points + shift_m)) for one in kept]
    return City(moved, f"{city.source}, with errors") if moved else None
