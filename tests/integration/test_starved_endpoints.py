"""A flood starves an autopilot that processes so many frames a second, and nobody else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_data
from skyrange.study.runs import fly

pytestmark = pytest.mark.rotating

LIMIT = {"match": "*.autopilot", "frames_per_s": 400, "queue_frames": 39}
PLAN = {"square": {"side_m": 30, "alt_m": 15}}
FLOOD = {"links": ["gcs:blue/b1"], "message": "PING", "rate_hz": 2000}


def flown(folder: Path, limits: list[dict[str, Any]], **attack: Any) -> RunRecord:
    data = {
        "name": "starved",
        "duration_s": 15,
        "origin": [40.778, -73.955, 20],
        "processing": limits,
        "operators": [
            {
                "id": "blue",
                "params": {"FS_GCS_ENABLE": 1, "FS_GCS_TIMEOUT": 5},
                "vehicles": [{"id": "b1", "plan": PLAN}, {"id": "b2", "start": [100, 0], "plan": PLAN}],
            }
        ],
        "attacks": [{"id": "flood", "kind": "link.flood", "start_s": 7, "params": FLOOD, **attack}],
    }
    return fly(load_data(data, "test"), folder, report=False)


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> dict[str, RunRecord]:
    folder = tmp_path_factory.mktemp("starved")
    return {
        "starved": flown(folder / "starved", [LIMIT]),
        "muted": flown(folder / "muted", [LIMIT], muted=True),
        "unlimited": flown(folder / "unlimited", []),
    }


def to_autopilot(record: RunRecord, vehicle: str) -> list[dict[str, Any]]:
    rows = record.table("frames", ["link", "direction", "fate", "sent_ns", "arrived_ns"]).to_pylist()
    mine = [row for row in rows if row["link"] == f"autopilot:{vehicle}" and row["direction"] == "fwd"]
    return [row for row in mine if row["sent_ns"] > 8e9]


def latency_ms(rows: list[dict[str, Any]]) -> float:
    """The median."""
    took = sorted(row["arrived_ns"] - row["sent_ns"] for row in rows if row["fate"] == "delivered")
    return float(took[len(took) // 2] / 1e6)


def returns(record: RunRecord) -> list[float]:
    rows = record.table("events").to_pylist()
    return [row["time_ns"] / 1e9 for row in rows if row["kind"] == "event.mode" and "gcs_failsafe" in row["data"]]


@pytest.mark.slow
def test_the_autopilot_is_late_and_loses_frames(records: dict[str, RunRecord]) -> None:
    starved, muted, free = (to_autopilot(records[name], "blue/b1") for name in ("starved", "muted", "unlimited"))
    assert latency_ms(free) == pytest.approx(0.1)
    assert 2.6 <= latency_ms(muted) < 10.0  # a frame alone takes 2.5 ms; a station sends several together
    assert 95.0 < latency_ms(starved) <= 100.1  # behind a full queue
    lost = sum(row["fate"] == "overflow" for row in starved) / len(starved)
    assert lost == pytest.approx(1 - 400 / 2000, abs=0.01)
    assert not any(row["fate"] == "overflow" for row in muted + free)


def test_its_failsafe_acts_because_heartbeats_are_lost(records: dict[str, RunRecord]) -> None:
    assert 12.0 <= returns(records["starved"])[0] < 14.0
    assert returns(records["muted"]) == returns(records["unlimited"]) == []


def test_the_others_fly_as_without_the_flood(records: dict[str, RunRecord]) -> None:
    def truth(record: RunRecord) -> list[dict[str, Any]]:
        return [row for row in record.table("truth").to_pylist() if row["vehicle"] == "blue/b2"]

    assert truth(records["starved"]) == truth(records["muted"])
    assert to_autopilot(records["starved"], "blue/b2") == to_autopilot(records["muted"], "blue/b2")


def test_the_record_says_who_is_limited_and_who_overflows(records: dict[str, RunRecord]) -> None:
    assert records["unlimited"].manifest.get("processing") is None
    assert records["starved"].manifest["processing"] == [
        {"endpoint": f"blue/{name}.autopilot", "frames_per_s": 400, "queue_frames": 39} for name in ("b1", "b2")
    ]
    rows = records["starved"].table("events").to_pylist()
    assert {row["about"] for row in rows if row["kind"] == "event.processing_overflow"} == {"blue/b1.autopilot"}
