"""The buildings of `--buildings`, which replace the city of a scenario and move its origin."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from skyrange.city.building_files import load_buildings
from skyrange.core.input_files import expand_user


def replace_city(data: Mapping[str, Any], file: str | Path) -> dict[str, Any]:
    """A scenario's table with the city replaced by a file of buildings and the origin moved to the middle of it.

    The heights of the old origin do not apply at the new one, so `origin.alt_msl_m` and `origin.geoid_m` become 0; set
    them if they matter. Raises InputError for an invalid file.
    """
    path = expand_user(file).absolute()
    _, middle = load_buildings(path)
    origin = {"lat": round(middle.lat_deg, 7), "lon": round(middle.lon_deg, 7)}
    return {**data, "origin": origin, "city": {"buildings": str(path)}}
