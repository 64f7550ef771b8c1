"""Scans of a scenario as the autopilot gets them: with and without a radio medium, signed, and refused before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import skyrange
from skyrange.codec.mavlink import decode
from skyrange.codec.mavlink.signing import is_signed
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.record import RunRecord
from skyrange.scenario.model.scenario import Scenario

LOOKS = """
name = "told"
seed = 3
duration_s = 12
origin = [40.76, -73.98]
[[operators]]
id = "blue"
[[operators.vehicles]]
start = [0, 0, 90]
plan = { square = { side_m = 30, alt_m = 20 } }
sensors = [
    { model = "vlp-16", azimuths = 180, to_autopilot = "obstacles" },
    { model = "lidar-lite-v3hp", pitch_deg = -90, to_autopilot = "distance" },
    { model = "d435", pixels = [32, 24] },
]
[[operators.vehicles]]
start = [6, 0]
plan = { square = { side_m = 30, alt_m = 20 } }
"""
NOTHING = LOOKS.replace(', to_autopilot = "obstacles"', "").replace(', to_autopilot = "distance"', "")
KINDS = ("DISTANCE_SENSOR", "OBSTACLE_DISTANCE")


def told(run: RunRecord, link: str = "autopilot:blue/b1") -> list[tuple[int, Any, bytes]]:
    """When each report was sent on a link, and what it says."""
    payloads = {row["payload_id"]: row["payload"] for row in run.table("payloads").to_pylist()}
    found = []
    for row in run.table("frames").to_pylist():
        if row["link"] == link:
            message = decode(payloads[row["payload_id"]])
            if message.get_type() in KINDS:
                found.append((row["sent_ns"], message, payloads[row["payload_id"]]))
    return found


@pytest.mark.parametrize("radio", ["", "[radio]\n"])
def test_the_autopilot_is_told_ten_times_a_second(radio: str, tmp_path: Path) -> None:
    run = skyrange.run(Scenario.from_toml(LOOKS + radio), tmp_path / "run")
    for kind in KINDS:
        sent = np.array([at for at, message, _ in told(run) if message.get_type() == kind])
        assert 115 <= len(sent) <= 121
        assert np.diff(sent).min() >= 0.099 * NS_PER_S
    truth = [row for row in run.table("truth").to_pylist() if row["vehicle"] == "blue/b1"]
    times, heights = [row["time_ns"] for row in truth], [row["up_m"] for row in truth]
    checked = 0
    for _, message, _ in told(run):
        if message.get_type() == KINDS[0]:
            height = float(np.interp(message.time_boot_ms * 1e6, times, heights))
            if 1.0 < height < 10.0:
                assert message.current_distance * 0.01 == pytest.approx(height + 0.05, abs=0.15)
                checked += 1
    assert checked >= 5
    ahead = [message.distances[0] for at, message, _ in told(run) if message.get_type() == KINDS[1] and at < NS_PER_S]
    assert len(ahead) == 9
    assert ahead == pytest.approx([575] * 9, abs=25)


def test_nothing_is_told_unless_asked_for_and_telling_alters_no_flight(tmp_path: Path) -> None:
    quiet = skyrange.run(Scenario.from_toml(NOTHING), tmp_path / "quiet")
    loud = skyrange.run(Scenario.from_toml(LOOKS), tmp_path / "loud")
    assert told(quiet) == []
    assert told(loud)
    assert quiet.manifest["digests"]["truth"] == loud.manifest["digests"]["truth"]


@pytest.mark.parametrize("radio", ["", "[radio]\n"])
def test_an_operator_that_signs_has_reports_signed(radio: str, tmp_path: Path) -> None:
    text = LOOKS.replace('id = "blue"\n', 'id = "blue"\nsigning = "on"\n')
    run = skyrange.run(Scenario.from_toml(text + radio, ("duration_s=3",)), tmp_path / "run")
    assert len(told(run)) > 30
    assert all(is_signed(payload) for _, _, payload in told(run))
    kinds = run.table("events").column("kind").to_pylist()
    assert "event.signature_refused" not in kinds


BAD = {
    'model = "lidar-lite-v3hp", to_autopilot = "obstacles"': "obstacles — expected a sensor with more than one beam",
    'model = "vlp-16", to_autopilot = "distance"': "distance — expected a single beam",
    'model = "lidar-lite-v3hp", yaw_deg = 10, to_autopilot = "distance"': "a multiple of 45",
    'model = "d435", to_autopilot = "obstacles" }, { model = "mid-360", to_autopilot = "obstacles"': "one sensor of an",
    'model = "d435", to_autopilot = "all"': "to_autopilot",
}


@pytest.mark.parametrize("bad", BAD)
def test_a_report_that_cannot_be_is_named_before_the_run(bad: str, tmp_path: Path) -> None:
    text = LOOKS.replace('model = "vlp-16", azimuths = 180, to_autopilot = "obstacles"', bad)
    with pytest.raises(InputError, match=BAD[bad]):
        skyrange.run(Scenario.from_toml(text), tmp_path / "run")
