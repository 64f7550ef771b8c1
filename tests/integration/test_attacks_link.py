"""What attacks on links do to a flight: shipped examples, flown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from skyrange.record import RunRecord
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly


def flown(name: str, folder: Path, *overrides: str) -> RunRecord:
    return fly(load(name, list(overrides)), folder / "run", report=False)


def rows(record: RunRecord, table: str, kind: str) -> list[dict[str, Any]]:
    found = [row for row in record.table(table).to_pylist() if row["kind"] == kind]
    return [{**row, **json.loads(row["data"])} for row in found]


def test_an_outage_fires_the_failsafe_and_ends(tmp_path: Path) -> None:
    record = flown("link.break", tmp_path, "duration_s=36")
    (failsafe,) = [row for row in rows(record, "events", "event.mode") if row["reason"] == "gcs_failsafe"]
    assert failsafe["mode"] == "RTL"
    assert 29e9 < failsafe["time_ns"] < 31e9, "5 s after the last heartbeat before the outage at 25 s"
    assert rows(record, "decisions", "decision.link_lost")
    (back,) = rows(record, "decisions", "decision.link_restored")
    assert 33e9 < back["time_ns"] < 35e9


def test_a_mission_that_does_not_arrive_is_not_flown(tmp_path: Path) -> None:
    record = flown("link.drop", tmp_path, "duration_s=45")
    assert record.outcomes["blue/b1"]["state"] == "failed"
    assert "mission upload" in record.outcomes["blue/b1"]["reason"]
    assert not rows(record, "events", "event.takeoff")


def test_altered_targets_are_flown_to(tmp_path: Path) -> None:
    record = flown("link.corrupt", tmp_path, "duration_s=40")
    truth = record.table("truth", ["north_m"]).column("north_m").to_pylist()
    assert max(map(abs, truth)) > 40, "10 m beyond the square"
    assert not rows(record, "events", "event.bad_frame"), "the checksum is right"


def test_an_eavesdropper_knows_the_mission(tmp_path: Path) -> None:
    record = flown("link.eavesdrop", tmp_path, "duration_s=8")
    learnt = rows(record, "events", "event.learned")
    assert {row["source"] for row in learnt} == {"eavesdrop@gcs:blue/b1.companion"}
    assert sorted(row["seq"] for row in learnt if row["what"] == "mission_item") == list(range(8))
    assert record.rows("labels") == 0
    alone = flown("link.eavesdrop", tmp_path / "muted", "duration_s=8", "attacks.eavesdrop.muted=true")
    assert not rows(alone, "events", "event.learned")
    assert alone.table("frames") == record.table("frames")
