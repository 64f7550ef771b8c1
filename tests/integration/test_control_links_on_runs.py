"""Runs whose control links are over the air: what is recorded, forked, muted, and what an attack on them does."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest

from skyrange.assembly.build import build
from skyrange.core.errors import InputError
from skyrange.kernel import Kernel
from skyrange.metrics.time_series import read_notes
from skyrange.record import RunRecord
from skyrange.record.write.memory_observer import MemoryObserver
from skyrange.runtime.live.range import prepare_range
from skyrange.scenario import Link, Radio, Scenario, WifiParams
from skyrange.study.runs import fly

pytestmark = pytest.mark.rotating

DEAUTHENTICATION = "control_link.deauthenticate"


def losses(record: RunRecord, direction: str, since_s: float) -> tuple[int, int]:
    """Frames of the control links that were lost, and all of them, sent from a time on."""
    rows = [
        row
        for batch in record.batches("frames", ["link", "direction", "fate", "sent_ns"])
        for row in batch.to_pylist()
        if row["link"].startswith("gcs:") and row["direction"] == direction and row["sent_ns"] >= since_s * 1e9
    ]
    return sum(row["fate"] == "lost" for row in rows), len(rows)


def with_links(scenario: Scenario, *rules: Link) -> Scenario:
    return scenario.model_copy(update={"links": rules})


def test_a_deauthentication_ends_the_link_and_802_11w_protects_it(tmp_path: Path) -> None:
    scenario = Scenario.from_file(DEAUTHENTICATION).model_copy(update={"duration_s": 33.0})
    attacked = fly(scenario, tmp_path / "attacked", report=False)
    lost, sent = losses(attacked, "fwd", 26.0)
    assert sent > 10
    assert lost == sent
    assert any(note.kind == "event.deauthenticated" for note in read_notes(attacked, "events"))
    protected = Link(match="gcs:*", channel="wifi", wifi=WifiParams(protected=True))
    safe = fly(with_links(scenario, protected), tmp_path / "safe", report=False)
    assert losses(safe, "fwd", 26.0)[0] == 0
    refused = [note for note in read_notes(safe, "events") if note.kind == "event.management_frame_refused"]
    assert [note.data["count"] for note in refused[:4]] == [1, 2, 4, 8]


def test_a_fork_continues_as_the_run_does() -> None:
    scenario = Scenario.from_file(DEAUTHENTICATION).model_copy(update={"duration_s": 30.0})
    seen = [MemoryObserver(), MemoryObserver(), MemoryObserver()]
    straight = Kernel(build(scenario).wiring, [seen[0]])
    straight.advance(28_000_000_000)
    stem = Kernel(build(scenario).wiring, [seen[1]])
    stem.advance(24_500_000_000)
    seen[2] = copy.deepcopy(seen[1])
    fork = stem.fork([seen[2]])
    fork.advance(28_000_000_000)
    stem.advance(28_000_000_000)
    rows = [[(f.sent_ns, f.id, f.fate, f.arrived_ns) for f in one.frames] for one in seen]
    assert sorted(rows[0]) == sorted(rows[1]) == sorted(rows[2])


def test_a_far_aircraft_loses_its_wifi_and_a_cellular_one_hands_over(tmp_path: Path) -> None:
    """Two aircraft fly the same 1.2 km: the one over Wi-Fi is lost, the other changes its cell."""
    text = """
name = "far"
duration_s = 58
origin = [40.0, -73.0]
[radio]
[[links]]
match = "gcs:blue/*"
channel = "wifi"
wifi = { power_dbm = 5, aircraft_dbm = 5 }
[[links]]
match = "gcs:green/*"
channel = "cellular"
cellular = { base_stations = [
  { id = "west", place = [-100, 50, 25], power_dbm = 30 },
  { id = "east", place = [1300, 50, 25], power_dbm = 30 },
] }
"""
    for colour, north_m in (("blue", 0), ("green", 60)):
        text += f"""
[[operators]]
id = "{colour}"
station = [0, 0]
  [[operators.vehicles]]
  id = "a"
  start = [250, {north_m}]
  params = {{ FS_GCS_ENABLE = 0 }}
  plan = {{ speed_mps = 15, path = {{ alt_m = 30, points = [[1200, 0]] }} }}
"""
    record = fly(Scenario.from_toml(text), tmp_path / "run", report=False)
    notes = read_notes(record, "events")
    handovers = [(note.about, note.data["from"], note.data["to"]) for note in notes if note.kind == "event.handover"]
    assert handovers[0] == ("gcs:green/a", "west", "east")
    assert handovers[-1] == ("gcs:green/a", "west", "east")
    assert len(handovers) <= 3  # shadowing may make it go back once
    assert {note.about for note in notes if note.kind == "event.link_down"} == {"gcs:blue/a"}


def test_the_air_needs_one_process(tmp_path: Path) -> None:
    scenario = Scenario.from_file("squares")
    over_wifi = scenario.model_copy(update={"radio": Radio(), "links": (Link(match="gcs:*", channel="wifi"),)})
    with pytest.raises(InputError, match=r"channel over the air.*--group one"):
        prepare_range(over_wifi, tmp_path / "run", group="component")
