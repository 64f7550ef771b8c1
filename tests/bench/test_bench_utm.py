"""Do the benchmarks of flight approval and of route planning measure what they say?"""

from __future__ import annotations

import json

import pytest

from skyrange.bench import approval, planning, utm_services
from skyrange.cli.part_benchmarks import planning_bench
from skyrange.planning.limits import Limits
from skyrange.planning.routes import find_route


def test_approval_is_measured_while_intents_are_accepted() -> None:
    row = approval.measure(active=30, requests=20)
    assert row["active"] == 30
    assert 0.0 <= row["rejected"] <= 1.0
    assert row["p50_ms"] <= row["p99_ms"]
    assert row["decisions_per_s"] > 1.0


@pytest.mark.slow
def test_services_are_measured_with_their_databases() -> None:
    assert utm_services.measure_durable(5)["requests"] == 5
    row = utm_services.measure_federation(6, 2)
    assert (row["service"], row["clients"], row["requests"]) == ("USS and DSS", 2, 6)
    assert 0.0 < row["p50_ms"] <= row["p99_ms"]
    assert utm_services.measure_authority(6, 3)["decisions_per_s"] > 1.0


def test_routes_are_planned_between_free_places() -> None:
    city = planning.load_city(None)
    row = planning.measure(city, routes=4, length_m=300.0, alt_m=30.0, ceiling_m=60.0)
    assert (row["routes"], row["buildings"]) == (4, 576)
    assert row["detour"] >= 1.0
    assert row["p50_ms"] <= row["p95_ms"]
    assert len(find_route(city, [(-188.0, 0.0), (188.0, 0.0)], Limits(30.0, 60.0))) == 2, "along a street"


@pytest.mark.parametrize("iterations", [0, 500])
def test_the_command_prints_json(iterations: int, capsys: pytest.CaptureFixture[str]) -> None:
    planning_bench(routes=2, length_m=200.0, alt_m=[60.0], ceiling_m=60.0, ompl=iterations, as_json=True)
    (row,) = json.loads(capsys.readouterr().out)
    assert row["alt_m"] == 60.0
    assert row["late"] >= row["detour"] >= 1.0
