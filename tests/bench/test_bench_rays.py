"""Does the benchmark of rays count what it casts, and give the same results every time?"""

from __future__ import annotations

import json

import pytest

from skyrange.bench import rays
from skyrange.city.downtown import downtown_grid
from skyrange.cli.part_benchmarks import rays_bench
from skyrange.core.errors import InputError


def test_rays_are_counted_and_their_results_repeat() -> None:
    city = downtown_grid((3, 3))
    one, two = (rays.measure(city, "small", 12, scans) for scans in (1, 2))
    assert (one["rays"], two["rays"]) == (115_200, 230_400)
    assert one["digest"] == two["digest"]
    assert sum(one["met"].values()) == pytest.approx(1.0, abs=1e-4)
    assert min(one["met"][name] for name in ("nothing", "ground", "building")) > 0.0
    assert one["digest"] != rays.measure(city, "small", 200, 1)["digest"], "of more aircraft, some are met"


def test_the_command_prints_json(capsys: pytest.CaptureFixture[str]) -> None:
    rays_bench(aircraft=[10], scans=1, as_json=True)
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["scene"], row["buildings"], row["aircraft"]) == ("generated downtown", 576, 10)
    assert row["rays_per_s"] > 10_000


def test_aircraft_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="10 or more"):
        rays.measure(downtown_grid((1, 1)), "small", 9, 1)
