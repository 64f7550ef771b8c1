"""Sionna RT traces a tiny city: free space in sight, losses behind a wall, and a table that repeats."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.core.errors import InputError
from skyrange.radio.propagation.loss_table import free_space_of
from skyrange.radio.propagation.loss_table_file import LossTableFile, read_loss_table
from skyrange.radio.propagation.obstruction import has_line_of_sight, obstacle_index
from skyrange.radio_map.mapping import MapLayout, prepare_map, trace_map
from skyrange.radio_map.sionna import SionnaTracer, TraceSettings, check_installed, describe_tracer


def _missing() -> str:
    """Why Sionna RT cannot run here; empty if it can."""
    try:
        check_installed()
    except InputError as error:
        return f"Sionna RT: {error}"
    return ""


pytestmark = pytest.mark.external(missing=_missing())

WALL = City([Building("wall", 40.0, shapely.box(-5.0, -60.0, 5.0, 60.0))], "test")
LAYOUT = MapLayout((-100.0, -100.0, 100.0, 100.0), 20.0, (2.0, 20.0, 60.0), 1_000.0, (20.0,))
MAST = (-50.0, 0.0, 10.0)
SETTINGS = TraceSettings(samples=400_000)


@pytest.fixture(scope="module")
def traced(tmp_path_factory: pytest.TempPathFactory) -> list[LossTableFile]:
    """The same map, twice."""
    folder = tmp_path_factory.mktemp("sionna")
    tracer = SionnaTracer(WALL, SETTINGS)
    maps = []
    for name in ("a", "b"):
        job = prepare_map(WALL, LAYOUT, [MAST], 2437.0, describe_tracer(SETTINGS), folder / name)
        trace_map(job, tracer)
        maps.append(read_loss_table(folder / name))
    return maps


def _seen(content: LossTableFile) -> np.ndarray:
    """(heights, rows, columns): points in sight of the mast, by skyrange's own geometry."""
    obstacles = obstacle_index(WALL.walls())
    points = content.header.grid.grid.points_enu_m
    flat = [has_line_of_sight(obstacles, *MAST, *point) for point in points.reshape(-1, 3).tolist()]
    return np.array(flat).reshape(points.shape[:-1])


def test_points_in_sight_have_free_space_and_reflections_that_add(traced: list[LossTableFile]) -> None:
    content = traced[0]
    grid = content.header.grid.grid
    excess = content.loss_db[0] - free_space_of(content.places_enu_m[0], grid, 2437.0)
    seen = _seen(content) & np.isfinite(content.loss_db[0])
    assert seen.sum() > 100
    # a ground and a wall of the same strength as the direct ray would add 4.8 dB; one sampled ray may count double
    assert (excess[seen] <= 0.01).all()
    assert -4.8 < np.median(excess[seen]) < -0.1
    assert np.percentile(excess[seen], 5) > -10.0


def test_the_wall_shadows_what_is_behind_it(traced: list[LossTableFile]) -> None:
    content = traced[0]
    low, behind = content.loss_db[0, 0], content.header.grid.grid.points_enu_m[0, :, :, 0] > 10.0
    hidden = behind & ~_seen(content)[0]
    free = free_space_of(content.places_enu_m[0], content.header.grid.grid, 2437.0)[0]
    excess = (low - free)[hidden]
    assert hidden.sum() > 10
    assert np.isnan(excess).mean() < 0.8  # behind its middle no path with one edge arrives
    assert np.nanmedian(excess) > 20.0


def test_a_map_repeats(traced: list[LossTableFile]) -> None:
    one, two = (content.loss_db for content in traced)
    np.testing.assert_array_equal(np.isnan(one[:, 1:]) & np.isnan(two[:, 1:]), np.isnan(one[:, 1:]))
    both = np.isfinite(one) & np.isfinite(two)
    assert np.percentile(np.abs(one - two)[both], 90) < 0.1
    assert traced[0].header == traced[1].header


def test_provenance_names_program_and_settings(traced: list[LossTableFile], tmp_path: Path) -> None:
    tracer = traced[0].header.tracer
    assert tracer["name"] == "sionna-rt"
    assert tracer["samples"] == 400_000
    assert math.isclose(traced[0].header.frequency_mhz, 2437.0)
