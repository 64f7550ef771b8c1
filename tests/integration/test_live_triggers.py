"""Does a tap in one process act from when a trigger holds in another, the world's?"""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.core.time import NS_PER_S
from tests.integration.live_programs import live
from tests.ports import OFFSET

pytestmark = pytest.mark.realtime

FOR_S = 6.0
SCENARIO = f"""
name = "triggered"
seed = 4
duration_s = 32
origin = [-35.363328, 149.1652241]

[radio]

[[operators]]
id = "blue"
vehicles = [
  {{ id = "b1", remote_id = {{}}, plan = {{ path = {{ points = [[0.0, 30.0]], alt_m = 4.0 }}, end = "land" }} }},
]

[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
when = {{ vehicle = "blue/b1", within_m = 3.0, of = [0.0, 15.0, 4.0] }}
for_s = {FOR_S}
params = {{ at = [50.0, 0.0, 20.0], via = "link", on = "blue/b1", rate_hz = 4.0 }}
"""


def test_a_trigger_that_the_world_sees_starts_a_tap_elsewhere(tmp_path: Path) -> None:
    with live(tmp_path, SCENARIO, OFFSET, "--group", "component") as flight:
        facts, record = flight.landed()
    assert facts["live"]["links"]["rid_up:blue/b1"].startswith("zmq://")
    starts = [row for row in record.table("events").to_pylist() if row["kind"] == "event.attack_start"]
    (start_ns,) = [row["time_ns"] for row in starts]
    north_m = [(row["time_ns"], row["north_m"]) for row in record.table("truth").to_pylist()]
    assert max(time_ns for time_ns, north in north_m if north < 12.0) <= start_ns  # 3 m before that place
    assert min(north for time_ns, north in north_m if time_ns >= start_ns) > 11.9
    acts = sorted(row["at_ns"] for row in record.table("labels").to_pylist() if row["attack"] == "ghost")
    period_ns = NS_PER_S // 4
    assert start_ns <= acts[0] < start_ns + period_ns + NS_PER_S // 10
    assert acts[-1] < start_ns + FOR_S * NS_PER_S <= acts[-1] + period_ns + NS_PER_S // 10
    assert len(acts) >= FOR_S * 4
    # what was put onto the companion's link went out by its radio, as its own
    frames = {frame.id: frame for frame in record.frames_with_payloads()}
    labels = [row for row in record.table("labels").to_pylist() if row["attack"] == "ghost"]
    assert {frames[row["child"] or row["frame"]].link for row in labels} == {"rid_up:blue/b1"}
