"""A defence that takes processor time: latency while nobody attacks, and a station that is starved by a flood."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skyrange.metrics.links import measure_transit_ms
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_data
from skyrange.study.runs import fly

pytestmark = pytest.mark.slow

PLAN = {"square": {"side_m": 30, "alt_m": 15}}
FLOOD = {"links": ["gcs:blue/b1"], "message": "PING", "rate_hz": 2000}
BUFFER = {"match": "*.companion", "frames_per_s": 1e6, "queue_frames": 64}
"""A buffer of 64 frames, and next to no time for what is not inspected."""


def flown(folder: Path, duration_s: float, flood: bool = True, **defence: Any) -> RunRecord:
    vehicle = {"id": "b1", "plan": PLAN}
    data = {
        "name": "costly",
        "duration_s": duration_s,
        "origin": [40.778, -73.955, 20],
        "processing": [BUFFER],
        "operators": [{"id": "blue", "params": {"FS_GCS_ENABLE": 1, "FS_GCS_TIMEOUT": 5}, "vehicles": [vehicle]}],
        "attacks": [{"id": "flood", "kind": "link.flood", "start_s": 12, "params": FLOOD, "muted": not flood}],
        "defences": [{"id": "signing", "kind": "mavlink.signing", **defence}],
    }
    return fly(load_data(data, "test"), folder, report=False)


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> dict[str, RunRecord]:
    folder = tmp_path_factory.mktemp("costly")
    cost = {"us_per_frame": 2000}
    return {
        "free": flown(folder / "free", 19),
        "costly": flown(folder / "costly", 25, cost=cost),
        "quiet": flown(folder / "quiet", 20, flood=False, cost=cost),
        "plain": flown(folder / "plain", 20, flood=False),
        "muted": flown(folder / "muted", 14, cost=cost, muted=True),
        "free-muted": flown(folder / "free-muted", 14, muted=True),
    }


def from_station(record: RunRecord) -> list[dict[str, Any]]:
    """What the station's end of the link signed and sent to the aircraft while the flood went on."""
    columns = ["link", "direction", "sender", "fate", "sent_ns", "arrived_ns"]
    rows = record.table("frames", columns).to_pylist()
    mine = [row for row in rows if row["link"] == "gcs:blue/b1" and row["direction"] == "fwd"]
    return [row for row in mine if row["sent_ns"] > 13e9 and row["sender"] == "signing@gcs:blue/b1.gcs"]


def events(record: RunRecord, kind: str) -> list[dict[str, Any]]:
    return [row for row in record.table("events").to_pylist() if row["kind"] == kind]


@pytest.mark.slow
def test_a_costly_defence_delays_every_frame_while_nobody_attacks(records: dict[str, RunRecord]) -> None:
    quiet, plain = (measure_transit_ms(records[name]) for name in ("quiet", "plain"))
    assert quiet["gcs"][0] - plain["gcs"][0] == pytest.approx(4.0)  # at each end of the link 2 ms
    assert quiet["autopilot"] == plain["autopilot"]
    assert plain["log"][1] + 0.5 < quiet["log"][1] <= plain["log"][1] + 2.0  # behind a frame that is inspected
    assert not events(records["quiet"], "event.processing_overflow")
    assert events(records["quiet"], "event.takeoff")
    assert not records["quiet"].table("alerts").num_rows


def test_a_flood_starves_the_processor_of_a_costly_defence(records: dict[str, RunRecord]) -> None:
    sent = from_station(records["costly"])
    assert sum(row["fate"] == "overflow" for row in sent) > 0.5 * len(sent) > 5
    assert {row["about"] for row in events(records["costly"], "event.processing_overflow")} == {"blue/b1.companion"}
    assert [row for row in events(records["costly"], "event.mode") if "gcs_failsafe" in row["data"]]


def test_the_same_defence_free_of_charge_stops_the_flood(records: dict[str, RunRecord]) -> None:
    assert not [row for row in from_station(records["free"]) if row["fate"] == "overflow"]
    assert not [row for row in events(records["free"], "event.mode") if "gcs_failsafe" in row["data"]]


def test_a_muted_one_costs_nothing(records: dict[str, RunRecord]) -> None:
    muted, free = records["muted"].manifest, records["free-muted"].manifest
    assert muted["digests"]["truth"] == free["digests"]["truth"]
    assert muted["digests"]["frames"] == free["digests"]["frames"]
    assert muted["defences"][0]["cost"] == {"us_per_frame": 2000.0}
    assert "cost" not in free["defences"][0]
