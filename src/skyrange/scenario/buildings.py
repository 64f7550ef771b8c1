"""Buildings brought by `--buildings`: they replace a scenario's city and move its origin."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from skyrange.city.geojson import load_geojson


def replace_city(data: Mapping[str, Any], file: str | Path) -> dict[str, Any]:
    """A scenario's table with the city replaced by a GeoJSON file and the origin moved to the middle of it.

    Heights of the old origin do not apply there and are left out, so they become 0: set
    `origin.alt_msl_m` and `origin.geoid_m` where they matter. Raises InputError for a bad file.
    """
    path = Path(file).expanduser().absolute()
    _, middle = load_geojson(path)
    origin = {"lat": round(middle.lat_deg, 7), "lon": round(middle.lon_deg, 7)}
    return {**data, "origin": origin, "city": {"buildings": str(path)}}
