"""A real ArduPilot believes what our ground station signs, obeys nobody else, and is believed in turn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skyrange.assembly.build import Additions
from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import is_signed
from skyrange.contracts.links import Act, TapPlacement
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_data
from skyrange.study.runs import fly
from tests.ardupilot import needs_arducopter
from tests.integration.test_signed_flights import LAND, Says, modes, notes, outcome

pytestmark = needs_arducopter

V = "blue/b1"


def scenario(signing: str, **changes: Any) -> Any:
    vehicle = {
        "id": "b1",
        "autopilot": "ardupilot",
        "start": [0.0, 0.0],
        "plan": {"path": {"points": [[0.0, 10.0]], "alt_m": 3.0}, "speed_mps": 4.0},
        "params": {"SCHED_LOOP_RATE": 100},
    }
    return load_data(
        {
            "name": "signed",
            "seed": 3,
            "duration_s": 70.0,
            "origin": {"lat": 40.778, "lon": -73.955},
            "operators": [{"id": "blue", "signing": signing, "vehicles": [vehicle]}],
            **changes,
        }
    )


@pytest.fixture(scope="module")
def signed(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return fly(scenario("on"), tmp_path_factory.mktemp("signed") / "run", report=False)


def test_it_flies_its_mission_with_every_frame_signed(signed: RunRecord) -> None:
    assert outcome(signed) == ("complete", "")
    assert notes(signed, "decision.signature_refused") == []
    frames = [
        row
        for table in signed.tables.frames_with_payloads(["link", "direction"])
        for row in table.to_pylist()
        if row["link"] == f"autopilot:{V}"
    ]
    assert {row["direction"] for row in frames} == {"fwd", "rev"}
    assert all(is_signed(row["payload"]) for row in frames)


def test_it_does_not_obey_what_nobody_signed(signed: RunRecord, tmp_path: Path) -> None:
    message = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_DO_SET_MODE, 0, 1, LAND, 0, 0, 0, 0, 0)
    forged = Packer(255, 190).pack(message)

    def flown(signing: str) -> RunRecord:
        taps = [TapPlacement(f"gcs:{V}", "companion", lambda link: Says([forged]), "mallory")]
        plans = [Act("mallory")]
        return fly(scenario(signing), tmp_path / signing, additions=Additions(taps, plans), report=False)

    assert "LAND" in modes(flown("off"), 0)
    safe = flown("on")
    assert "LAND" not in modes(safe, 0)
    assert safe.manifest["digests"]["truth"] == signed.manifest["digests"]["truth"]


def test_a_wrong_key_gives_no_control(tmp_path: Path) -> None:
    record = fly(scenario("wrong-key"), tmp_path / "run", report=False)
    assert outcome(record) == ("failed", "connecting for too long")
    assert notes(record, "event.armed") == []
    assert {row["reason"] for row in notes(record, "decision.signature_refused")} == {"wrong signature"}
