"""City of a scenario: read from its file, or generated."""

from __future__ import annotations

from skyrange.city.building_files import load_buildings
from skyrange.city.city import City
from skyrange.city.downtown import downtown_grid
from skyrange.scenario.model.scenario import Scenario


def build_city(scenario: Scenario) -> City | None:
    """The scenario's city in metres from its origin, None if it has none. Raises InputError for a bad file."""
    if scenario.city is None:
        return None
    if scenario.city.buildings is not None:
        return load_buildings(scenario.city.buildings, scenario.origin.datum)[0]
    grid = scenario.city.grid
    assert grid is not None  # the model allows exactly one of the two
    return downtown_grid(grid.blocks, grid.height_m, grid.seed, grid.street_m, grid.block_m)
