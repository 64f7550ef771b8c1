"""Which city stands around the fleet? Built as the scenario says, or brought by `--buildings`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from skyrange.city.city import City
from skyrange.city.downtown import downtown_grid
from skyrange.city.geojson import load_geojson
from skyrange.scenario.schema import Scenario


def build_city(scenario: Scenario) -> City | None:
    """The scenario's city in metres from its origin, None if it has none. Raises InputError for a bad file."""
    if scenario.city is None:
        return None
    if scenario.city.buildings is not None:
        return load_geojson(scenario.city.buildings, scenario.origin.datum)[0]
    grid = scenario.city.grid
    assert grid is not None  # the model allows exactly one of the two
    return downtown_grid(grid.blocks, grid.height_m, grid.seed, grid.street_m, grid.block_m)


def with_buildings(data: Mapping[str, Any], file: str | Path) -> dict[str, Any]:
    """A scenario's table with the city replaced by a GeoJSON file and the origin moved to the middle of it.

    Heights of the old origin do not apply there and are left out, so they become 0: set
    `origin.alt_msl_m` and `origin.geoid_m` where they matter. Raises InputError for a bad file.
    """
    path = Path(file).expanduser().absolute()
    _, middle = load_geojson(path)
    origin = {"lat": round(middle.lat_deg, 7), "lon": round(middle.lon_deg, 7)}
    return {**data, "origin": origin, "city": {"buildings": str(path)}}
