"""A first week with skyrange by the command line alone: own attack and detector, study, data set, score."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

pytestmark = pytest.mark.slow

CITY = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"height": height_m},
            "geometry": {
                "type": "Polygon",
                "coordinates": [
                    [[lon, lat], [lon + 3e-4, lat], [lon + 3e-4, lat + 2e-4], [lon, lat + 2e-4], [lon, lat]]
                ],
            },
        }
        for lon, lat, height_m in ((8.5450, 47.3970, 18.0), (8.5462, 47.3984, 25.0), (8.5474, 47.3970, 12.0))
    ],
}
SCENARIO = """
name = "courtyard"
duration_s = 60
origin = [47.3977, 8.5464]
city = { buildings = "blocks.geojson" }
wind = { speed_mps = 2, from_deg = 225 }

[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  start = [-4, -4]
  plan = { square = { side_m = 12, alt_m = 8 } }

[[attacks]]
id = "lower"
kind = "own.low"
params = { links = ["gcs:blue/b1"], by_m = 3 }

[[detectors]]
id = "altitudes"
kind = "own.altitudes"
"""
PLUGIN = '''
"""An attack that lowers the altitudes of a mission as it is uploaded, and a detector of low aircraft."""

from collections.abc import Sequence

import skyrange.plugin as sky


@sky.attack(
    "own.low",
    technique="T0831",
    surface=sky.CONTROL_LINKS,
    persists="upload",
    family="configuration_change",
    effect="the aircraft flies lower than planned",
    knowledge="the layout of mission items",
    equipment="a computer that decodes and rewrites frames",
    content="the sham: the same items, replaced by themselves",
    placement="the same on another link",
)
class Low(sky.OnMessages):
    """Lowers the altitudes of a mission while it is uploaded, and raises them again as the station reads it back."""

    by_m: sky.Number = sky.param("Metres by which altitudes are lowered.", default=3.0, gt=0, le=1000)

    def alter(self, now: sky.Time, message: sky.MavlinkMessage) -> bool:
        if message.get_type() != "MISSION_ITEM_INT" or message.command != sky.mavlink.MAV_CMD_NAV_WAYPOINT:
            return False
        message.z += -self.by_m if message.get_srcSystem() == sky.STATION[0] else self.by_m
        return True


@sky.detector("own.altitudes")
class Altitudes(sky.Detector):
    """Raises an alert where an aircraft flies level, but lower than it was told to."""

    below_m: sky.Number = sky.param("Height above home, in metres.", default=7.0, gt=0, le=500)
    service_ns: sky.Time = sky.NS_PER_S

    def observe(self, now: sky.Time, frames: sky.ObservedFrames) -> Sequence[sky.Alert]:
        reports = sky.read_messages(frames, "GLOBAL_POSITION_INT")
        alerts = []
        for row, value in zip(reports.rows.tolist(), reports.values, strict=True):
            height_m = value["relative_alt"] / 1000
            if abs(value["vz"]) < 10 and 2.0 < height_m < self.below_m:
                alerts.append(self.alert(now, frames.ports[frames.places[row]].link, float(self.below_m / height_m)))
        return alerts[-1:]
'''
STUDY = """
name = "heights"
scenario = "courtyard.toml"
seeds = 12
shared_seeds = false
arms = ["nominal", "attacked"]
keep = "everything"

[[draws]]
name = "wind"
key = "wind.speed_mps"
low = 0
high = 3
"""


def skyrange(folder: Path, *words: str, code: int = 0) -> str:
    """What a command says."""
    done = subprocess.run(
        [sys.executable, "-m", "skyrange", *words], cwd=folder, capture_output=True, text=True, check=False,
        env=os.environ | {"COLUMNS": "200"},
    )  # fmt: skip
    assert done.returncode == code, f"{words}: {done.stdout}{done.stderr}"
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


def test_from_an_own_scenario_to_a_score_and_a_figure(tmp_path: Path) -> None:
    (tmp_path / "blocks.geojson").write_text(json.dumps(CITY))
    (tmp_path / "courtyard.toml").write_text(SCENARIO)
    (tmp_path / "own.py").write_text(PLUGIN)
    (tmp_path / "heights.toml").write_text(STUDY)
    own = ("--plugin", "own.py")

    # the first try lacks the plugin, and the second has a mistyped key
    assert "own.low" in skyrange(tmp_path, "run", "courtyard.toml", code=2)
    said = skyrange(tmp_path, "run", "courtyard.toml", *own, "--set", "attacks.lower.params.by=3", code=2)
    assert "by_m" in said
    assert not (tmp_path / "runs").exists()

    assert "own.low" in skyrange(tmp_path, "attacks", *own)
    skyrange(tmp_path, "run", "courtyard.toml", *own, "--out", "first")
    assert "complete" in skyrange(tmp_path, "show", "first")
    assert "blue/b1" in (tmp_path / "first" / "report.html").read_text()
    skyrange(tmp_path, "verify", "first")
    skyrange(tmp_path, "export", "first", "--csv", "--tlog", "--mcap", "--kml")
    said = skyrange(tmp_path, "pair", "courtyard.toml", *own, "--out", "pair")
    assert "lower" in said
    assert "blue/b1" in said
    assert "lower" in (tmp_path / "pair" / "report.html").read_text()

    said = skyrange(tmp_path, "study", "run", "heights.toml", *own, "--dry-run")
    assert "24 runs" in said
    skyrange(tmp_path, "study", "run", "heights.toml", *own, "--out", "study", "--jobs", "2")
    assert "12 of 12" in skyrange(tmp_path, "study", "status", "study")
    skyrange(tmp_path, "study", "show", "study")
    skyrange(tmp_path, "study", "report", "study")
    assert list((tmp_path / "study" / "figures").glob("*.svg"))
    said = skyrange(tmp_path, "study", "score", "study")
    assert "altitudes" in said

    skyrange(tmp_path, "dataset", "build", "study", "data")
    rows = pq.read_table(tmp_path / "data" / "runs.parquet").to_pylist()
    assert {tuple(row["families"]) for row in rows if row["arm"] == "attacked"} == {("configuration_change",)}
    # twelve blocks tell no leak from chance, and the audit says so
    assert "too few blocks" in skyrange(tmp_path, "dataset", "audit", "data", code=2)
