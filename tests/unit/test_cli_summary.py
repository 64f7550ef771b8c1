"""What does the summary of a run say on a terminal? Causes first, and a large fleet by operator."""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.cli.output import run_summary


def aircraft(name: str, **changes: Any) -> dict[str, Any]:
    known = {
        "id": name, "operator": name.split("/")[0], "outcome": "complete", "reason": "", "mishap": None,
        "finished_s": 50.0, "landed_s": 48.25, "distance_m": 100.0, "highest_m": 20.0,
        "frames_sent": 9, "frames_received": 9,
    }  # fmt: skip
    return {**known, **changes}


def said(rows: list[dict[str, Any]], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("COLUMNS", "160")
    facts = {
        "name": "some", "status": "complete", "vehicles": rows, "mishaps": [], "timings": {}, "simulated_s": 60.0,
        "frames": 9, "seed": 1, "fingerprint": None, "path": "runs/some", "report": None,
    }  # fmt: skip
    run_summary.print_summary(facts)
    return capsys.readouterr().out


def test_a_collision_explains_an_outcome_better_than_the_ground_station_can(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [
        aircraft("a/1", outcome="failed", reason="disarmed at item 3 of 19", mishap="collision with b/1, 35.2 s"),
        aircraft("a/2", outcome="failed", reason="rejected"),
        aircraft("a/3", mishap="collision with building:2, 9.0 s"),
    ]
    out = said(rows, capsys, monkeypatch)
    assert "failed (collision with b/1, 35.2 s)" in out
    assert "disarmed" not in out
    assert "failed (rejected)" in out
    assert "building:2" not in out  # it completed its mission all the same
    assert "48.25 s" in out
    assert "50.0" not in out  # the report of the ground station


def test_a_large_fleet_is_said_by_operator_and_names_who_did_not_complete(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    count = run_summary.MAX_AIRCRAFT
    rows = [aircraft(f"{operator}/{number}") for operator in ("blue", "red") for number in range(count)]
    out = said(rows, capsys, monkeypatch)
    assert "blue/0" not in out
    assert "not complete" not in out
    assert [line.split()[1:6:2] for line in out.splitlines() if "red " in line] == [["red", str(count), str(count)]]
    rows[count + 3] |= {"outcome": "failed", "reason": "link lost"}
    out = said(rows, capsys, monkeypatch)
    assert "not complete: 1" in out
    assert "failed (link lost)" in out
    assert "red/3" in out
    assert "red/4" not in out


def test_of_a_station_outside_the_range_it_says_what_was_handed_over(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    told = {"frames_sent": 26_276, "frames_received": 26_276, "station_outside": True, "frames_from_station": 812}
    assert "26,276 handed over, 812 from it" in said([aircraft("a/1", **told)], capsys, monkeypatch)


def test_an_operator_that_equivocated_has_no_stake_in_the_next_run(capsys: pytest.CaptureFixture[str]) -> None:
    facts = {
        "name": "some", "status": "complete", "vehicles": [], "mishaps": [], "timings": {}, "simulated_s": 60.0,
        "frames": 9, "seed": 1, "fingerprint": None, "path": "runs/some", "report": None,
        "equivocators": ["blue", "red"],
    }  # fmt: skip
    run_summary.print_summary(facts)
    assert "--set 'approvals.hashgraph.stakes={ blue = 0, red = 0 }'" in capsys.readouterr().out
