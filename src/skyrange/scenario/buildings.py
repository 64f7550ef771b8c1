"""The buildings of `--buildings`, which replace the city of a scenario and move its origin."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from skyrange.city.geojson import load_geojson


def replace_city(data: Mapping[str, Any], file: str | Path) -> dict[str, Any]:
    """The table of a scenario with the city of a GeoJSON file and with the origin in the middle of that city.

    The heights of the old origin do not apply at the new one, so `origin.alt_msl_m` and `origin.geoid_m` become 0; set
    them if they matter. Raises InputError for an invalid file.
    """
    path = Path(file).expanduser().absolute()
    _, middle = load_geojson(path)
    origin = {"lat": round(middle.lat_deg, 7), "lon": round(middle.lon_deg, 7)}
    return {**data, "origin": origin, "city": {"buildings": str(path)}}
