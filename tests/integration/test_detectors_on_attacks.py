"""Each shipped detector on a small shipped attack: it finds the attack, and stays silent in the nominal run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from skyrange.assembly.build import Additions
from skyrange.contracts.monitors import DetectorContext, DetectorPlugin, Monitor, MonitorPlacement
from skyrange.core.chance import Chance
from skyrange.core.ids import vehicle_id
from skyrange.core.time import NS_PER_S
from skyrange.record import RunRecord, replay_monitor
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load as load_scenario
from skyrange.study.runs import fly as fly_scenario

pytestmark = pytest.mark.rotating

MAVLINK_COMMANDS = DetectorPlugin.find("mavlink.commands")
MAVLINK_RATE = DetectorPlugin.find("mavlink.rate")
MAVLINK_SEQUENCE = DetectorPlugin.find("mavlink.sequence")
MAVLINK_SOURCE = DetectorPlugin.find("mavlink.source")
MAVLINK_TIMING = DetectorPlugin.find("mavlink.timing")
REMOTE_ID_PLAUSIBILITY = DetectorPlugin.find("remote_id.plausibility")

ON_MAVLINK = {
    "commands": MAVLINK_COMMANDS,
    "rate": MAVLINK_RATE,
    "sequence": MAVLINK_SEQUENCE,
    "source": MAVLINK_SOURCE,
    "timing": MAVLINK_TIMING,
}


@dataclass(frozen=True)
class Maker:
    """Makes the monitor of a plugin with its default parameters."""

    plugin: DetectorPlugin
    scenario: Scenario
    params: Mapping[str, Any] = field(default_factory=dict)

    def __call__(self) -> Monitor:
        vehicles = [vehicle_id(operator.id, vehicle.id) for operator, vehicle in self.scenario.fleet]
        context = DetectorContext("d", vehicles, self.scenario.origin.datum, self.scenario.epoch, Chance(1))
        return self.plugin(self.plugin.params(**self.params), context)


def at_both_ends(scenario: Scenario) -> list[MonitorPlacement]:
    return [
        MonitorPlacement(f"{name}-{side}", Maker(plugin, scenario), ["gcs:*"], side)
        for name, plugin in ON_MAVLINK.items()
        for side in ("gcs", "companion")
    ]


def fly(name: str, duration_s: float, out: Path, monitors: Any) -> tuple[RunRecord, RunRecord]:
    """The records of the attacked and of the nominal run, with monitors."""
    records = []
    for arm, muted in (("attacked", "false"), ("nominal", "true")):
        scenario = load_scenario(name, [f"duration_s={duration_s}", f"attacks.0.muted={muted}"])
        records.append(
            fly_scenario(scenario, out / arm, report=False, additions=Additions(monitors=monitors(scenario)))
        )
    return records[0], records[1]


def alerts(record: RunRecord) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = record.table("alerts").to_pylist()
    return rows


def first_s(rows: Sequence[Mapping[str, Any]], detector: str) -> float:
    """When a detector raised its first alert."""
    return min(int(row["at_ns"]) for row in rows if row["detector"] == detector) / NS_PER_S


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("name", "duration_s", "onset_s", "found"),
    [
        ("mavlink.command", 40, 30, {"source-gcs", "sequence-companion", "commands-companion"}),
        ("mavlink.parameter", 30, 20, {"sequence-companion", "commands-companion"}),
        # values come in bursts of 8 KiB, which the queue of the link cannot hold: frames are missing at the station
        ("link.flood", 30, 15, {"rate-gcs", "rate-companion", "sequence-gcs", "sequence-companion", "timing-gcs"}),
        ("link.delay", 25, 15, {"timing-companion"}),
        ("link.duplicate", 35, 15, {"sequence-companion"}),
        ("identity.second_vehicle", 30, 15, {"sequence-gcs", "timing-gcs", "rate-gcs"}),
    ],
)
def test_detectors_of_mavlink(tmp_path: Path, name: str, duration_s: float, onset_s: float, found: set[str]) -> None:
    attacked, nominal = fly(name, duration_s, tmp_path, at_both_ends)
    assert alerts(nominal) == []
    rows = alerts(attacked)
    assert {row["detector"] for row in rows} == found
    assert {row["subject"] for row in rows} == {"blue/b1"}
    assert min(first_s(rows, detector) for detector in found) >= onset_s


def test_detector_of_remote_id(tmp_path: Path) -> None:
    def at_aircraft(scenario: Scenario) -> list[MonitorPlacement]:
        links = ["rid_down:blue/b1", "rid_data:blue/b1"]
        return [MonitorPlacement("remote_id", Maker(REMOTE_ID_PLAUSIBILITY, scenario), links, "companion")]

    attacked, nominal = fly("remote_id.replay", 33, tmp_path, at_aircraft)
    assert alerts(nominal) == []
    rows = alerts(attacked)
    assert 30.0 <= first_s(rows, "remote_id") <= 31.0
    assert {row["kind"].rpartition(".")[2] for row in rows} >= {"time", "velocity"}
    (placement,) = at_aircraft(load_scenario("remote_id.replay"))
    again = [(found.alert.at, found.alert.kind) for found in replay_monitor(attacked, placement)]
    assert again == [(row["at_ns"], row["kind"]) for row in rows]
