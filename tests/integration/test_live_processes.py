"""Processes of a live range that are killed, in virtual time; `test_live_range` and others kill real ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.integration.live_virtual import VirtualFlight, fly_virtual, prepared

SCENARIO = """
name = "live"
seed = 4
duration_s = 11

[origin]
lat = -35.363328
lon = 149.1652241

[[operators]]
id = "blue"
vehicles = [{ id = "b1", plan = { path = { points = [[0.0, 10.0]], alt_m = 5.0 }, end = "land" } }]

[[operators]]
id = "green"
vehicles = [{ id = "g1", start = [60.0, 0.0], plan = { path = { points = [[0.0, 10.0]], alt_m = 5.0 } } }]
"""


@pytest.mark.slow
def test_a_killed_companion_is_a_lost_link_and_what_it_recorded_stays(tmp_path: Path) -> None:
    async def kill(flight: VirtualFlight) -> None:
        await flight.until(
            lambda: (flight.part("blue-b1.companion") / ".spool" / "frames-0000.arrows").exists(), 9, "it"
        )
        await flight.reach(4.0)
        flight.system.process("blue/b1.companion").kill()

    flight = prepared(SCENARIO, tmp_path, on_death="continue")
    record = fly_virtual(flight, kill)
    live = record.manifest["live"]
    assert list(live["ended"]) == ["blue/b1.companion"]
    assert "SIGKILL" in live["ended"]["blue/b1.companion"]
    lost = [row for row in record.table("decisions").to_pylist() if row["kind"] == "decision.link_lost"]
    assert {row["about"] for row in lost} == {"blue/b1"}
    through = [row for row in record.table("frames").to_pylist() if row["link"] == "gcs:blue/b1"]
    assert sum(row["fate"] == "delivered" for row in through) > 10
    assert not any(process.running for starts in flight.system.processes.values() for process in starts)
