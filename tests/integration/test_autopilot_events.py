"""One flight of each autopilot notes the same kinds of events: fence, battery, home, parameters, uploads."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from skyrange.record import load
from skyrange.runtime.run import Run
from skyrange.scenario.toml_files import load_data
from tests.ardupilot import needs_arducopter

KINDS = {
    "event.armed", "event.battery", "event.disarmed", "event.fence", "event.fence_breach", "event.fence_cleared",
    "event.home", "event.item_reached", "event.landed", "event.mission", "event.mode", "event.parameter",
    "event.rally", "event.takeoff",
}  # fmt: skip


def scenario(autopilot: str) -> Any:
    """A climb beyond the highest altitude of the fence; home and the threshold of the battery are set in flight."""
    vehicle = {
        "id": "b1",
        "autopilot": autopilot,
        "plan": {
            "path": {"points": [[0, 10]], "alt_m": 14.0},
            "end": "land",
            "fence": {"circles": [{"center": [0, 0], "radius_m": 80}]},
            "rally": [[20, 0, 12]],
        },
        "params": {
            "FENCE_ENABLE": 1,
            "FENCE_TYPE": 5,
            "FENCE_ALT_MAX": 10,
            "FENCE_ACTION": 0,
            "BATT_LOW_TIMER": 1,
            "BATT_FS_LOW_ACT": 0,
        },
    }
    acts: dict[str, dict[str, Any]] = {
        "home": {"at": [5.0, 6.0, 0.0]},
        "parameter": {"values": {"BATT_LOW_VOLT": 13.0}},
    }
    attacks = [
        {"id": what, "kind": f"mavlink.{what}", "start_s": 14.0, "params": {"vehicles": ["blue/b1"], **params}}
        for what, params in acts.items()
    ]
    return load_data(
        {
            "name": "events",
            "seed": 4,
            "duration_s": 55.0,
            "origin": {"lat": 40.778, "lon": -73.955},
            "operators": [{"id": "blue", "vehicles": [vehicle]}],
            "attacks": attacks,
        }
    )


@pytest.mark.parametrize("autopilot", ["builtin", pytest.param("ardupilot", marks=needs_arducopter)])
def test_the_same_kinds_are_noted(autopilot: str, tmp_path: Path) -> None:
    Run.start(scenario(autopilot), tmp_path / "run").execute()
    record = load(tmp_path / "run")
    told = [(row["kind"], json.loads(row["data"])) for row in record.table("events").to_pylist()]
    first: dict[str, dict[str, Any]] = {}
    for kind, data in told:
        first.setdefault(kind, data)
    assert set(first) >= KINDS, KINDS - set(first)
    assert first["event.fence_breach"]["fence"] == "Max Alt fence"
    assert first["event.battery"]["level"] == "low"
    assert first["event.battery"]["voltage_v"] < 13.0
    assert first["event.parameter"] == {"name": "BATT_LOW_VOLT", "value": 13.0}
    assert first["event.home"]["east_m"] == pytest.approx(5.0, abs=0.05)
    assert first["event.home"]["north_m"] == pytest.approx(6.0, abs=0.05)
    assert [first[kind]["items"] for kind in ("event.mission", "event.fence", "event.rally")] == [5, 1, 1]
    order = [kind for kind, _ in told if kind in ("event.takeoff", "event.fence_breach", "event.fence_cleared")]
    assert order == ["event.takeoff", "event.fence_breach", "event.fence_cleared"]
