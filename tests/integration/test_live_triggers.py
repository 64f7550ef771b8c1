"""A trigger that holds in the world's process starts a tap in another; in virtual time."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from skyrange.core.time import NS_PER_S
from tests.integration.live_virtual import VirtualFlight, fly_virtual, prepared
from tests.live_ranges import VirtualSystem

SCENARIO = """
name = "triggered"
seed = 4
duration_s = {duration_s}
origin = [-35.363328, 149.1652241]

[radio]

[[operators]]
id = "blue"
vehicles = [
  {{ id = "b1", remote_id = {{}}, plan = {{ path = {{ points = [[0.0, 30.0]], alt_m = 3.0 }}, end = "land" }} }},
]

[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
when = {{ vehicle = "blue/b1", within_m = 1.0, of = [0.0, 0.0, 3.0] }}
for_s = {for_s}
params = {{ at = [50.0, 0.0, 20.0], via = "link", on = "blue/b1", rate_hz = 4.0 }}
"""
FOR_S = 2.5
PERIOD_NS = NS_PER_S // 4


def test_a_trigger_that_the_world_sees_starts_a_tap_elsewhere(tmp_path: Path) -> None:
    record = fly_virtual(prepared(SCENARIO.format(duration_s=10, for_s=FOR_S), tmp_path))
    assert record.manifest["live"]["links"]["rid_up:blue/b1"].startswith("zmq://")
    starts = [row for row in record.table("events").to_pylist() if row["kind"] == "event.attack_start"]
    (start_ns,) = [row["time_ns"] for row in starts]
    up_m = [(row["time_ns"], row["up_m"]) for row in record.table("truth").to_pylist()]
    assert max(time_ns for time_ns, up in up_m if up < 2.0) <= start_ns  # 1 m below that place
    assert min(up for time_ns, up in up_m if time_ns >= start_ns) > 1.9
    acts = sorted(row["at_ns"] for row in record.table("labels").to_pylist() if row["attack"] == "ghost")
    assert start_ns <= acts[0] < start_ns + PERIOD_NS + NS_PER_S // 10
    assert acts[-1] < start_ns + FOR_S * NS_PER_S <= acts[-1] + PERIOD_NS + NS_PER_S // 10
    assert len(acts) >= FOR_S * 4
    # what was put onto the companion's link went out by its radio, as its own
    frames = {frame.id: frame for frame in record.frames_with_payloads()}
    labels = [row for row in record.table("labels").to_pylist() if row["attack"] == "ghost"]
    assert {frames[row["child"] or row["frame"]].link for row in labels} == {"rid_up:blue/b1"}


@pytest.mark.slow
def test_a_tap_whose_process_is_started_anew_acts_on(tmp_path: Path) -> None:
    async def kill_the_companion(flight: VirtualFlight) -> None:
        await flight.decided("world", "events", "event.attack_start")
        flight.system.process("blue/b1.companion").kill()

    system = VirtualSystem(start_s=2.0)
    text = SCENARIO.format(duration_s=13, for_s=5)
    record = fly_virtual(prepared(text, tmp_path, on_death="restart", system=system), kill_the_companion)
    assert list(record.manifest["live"]["started_anew"]) == ["blue/b1.companion"]
    (start_ns,) = [row["time_ns"] for row in record.table("events").to_pylist() if row["kind"] == "event.attack_start"]
    acts = sorted(row["at_ns"] for row in record.table("labels").to_pylist() if row["attack"] == "ghost")
    gaps = sorted(later - earlier for earlier, later in itertools.pairwise(acts))
    # two seconds to start, a second of labels that had not been written, and the moment until its end was noticed
    assert 2 * NS_PER_S < gaps[-1] < 3.5 * NS_PER_S
    assert gaps[-2] < PERIOD_NS + NS_PER_S // 10
    assert acts[-1] < start_ns + 5 * NS_PER_S <= acts[-1] + PERIOD_NS + NS_PER_S // 10
