"""The bench flies what it says it measures. No figure is asserted: figures belong to machines."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from skyrange.assembly.placement.flight_plans import make_flight_plan
from skyrange.bench import fleet
from skyrange.bench.fleet import WARM_UP_S, fleet_scenario, measure
from skyrange.bench.sampling import PARTS, Sampler
from skyrange.core.errors import InputError
from skyrange.gcs.plan.routes import estimated_duration_s
from tests.bench.in_process import measure_here

pytestmark = pytest.mark.rotating


@pytest.mark.parametrize(("vehicles", "seconds"), [(1, 5.0), (3, 600.0), (600, 5.0)])
def test_every_mission_outlasts_the_measurement(vehicles: int, seconds: float) -> None:
    scenario = fleet_scenario(vehicles, seconds)
    fleet = [vehicle for _, vehicle in scenario.fleet]
    assert len(fleet) == vehicles
    assert len({(v.start.east_m, v.start.north_m) for v in fleet}) == vehicles
    plan = make_flight_plan(scenario.origin.datum, fleet[0])
    assert estimated_duration_s(plan) > WARM_UP_S + seconds
    assert len(plan.items) < 50, "a mission that takes long to upload would still be uploading when measuring begins"


def test_a_row_says_what_flew(monkeypatch: pytest.MonkeyPatch) -> None:
    measure_here(monkeypatch, fleet)
    row = measure(3, 4.0)
    assert row["vehicles"] == row["flying"] == 3
    assert row["real_time_factor"] * row["wall_s"] == pytest.approx(4.0, rel=0.05)  # both are rounded
    assert row["total_factor"] * row["total_s"] == pytest.approx(WARM_UP_S + 4.0, rel=0.05)
    assert row["total_s"] > row["setup_s"] + row["wall_s"] + row["finalise_s"]
    assert row["bytes_per_frame"] > 1.0
    assert row["cpu_s"] > 0.0
    assert row["yardsticks"] * row["yardstick_us"] == pytest.approx(row["cpu_s"] / 4.0 / 3 * 1e6, rel=0.05)
    assert row["memory_mb"] > row["base_memory_mb"] > 0.0
    # eight telemetry frames over three hops, and those for the broadcast over one more
    assert 3 * 8 * 3 <= row["frames_per_s"] <= 3 * 8 * 4 * 1.5
    assert set(row["share"]) == set(PARTS)
    assert sum(row["share"].values()) == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_json_is_a_list_of_rows() -> None:
    command = [sys.executable, "-c", "from skyrange.cli import main; main()", "bench", "fleet"]
    done = subprocess.run(
        [*command, "--vehicles", "1", "--vehicles", "2", "--seconds", "2", "--json"],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    rows = json.loads(done.stdout)
    assert [row["vehicles"] for row in rows] == [1, 2]
    assert all({"real_time_factor", "cpu_s", "memory_mb"} <= set(row) for row in rows)


def test_a_bench_that_cannot_run_says_so() -> None:
    with pytest.raises(InputError, match="operators: none — expected at least one operator"):
        measure(0, 1.0)


def test_samples_go_to_the_innermost_module_of_ours() -> None:
    from skyrange.codec.mavlink import Packer, decode, dialect

    packer = Packer(1, 1)
    message = dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
    with Sampler() as sampler:
        for _ in range(60_000):
            decode(packer.pack(message))
    shares = sampler.shares()
    assert shares["MAVLink"] > 0.5
    assert shares["physics"] == shares["recording"] == 0.0
