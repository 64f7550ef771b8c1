"""Batteries of ArduPilots: fed to builds that take them, and a warning before the run for those that do not."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from skyrange.assembly.aircraft import list_battery_warnings
from skyrange.cli.app import app
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.ardupilot.arducopter_binary import BATTERY, VARIABLE, examine_binary
from skyrange.vehicle.ardupilot.json_backend.json_lines import _BATTERY_LINE, LineWriter, format_lines
from skyrange.vehicle.ardupilot.json_backend.motion import STANDING, Motion, to_ardupilot_motion
from tests.unit.made_up_binaries import elf, firmware
from tests.unit.record_sample import StillWorld

ASKED: list[dict[str, Any]] = [
    {"charge": 0.3},
    {"params": {"BATT_FS_LOW_ACT": 2}},
    {"params": {"BATT_LOW_VOLT": 11.0}},
    {"params": {"BATT_CRT_MAH": 500}},
    {"params": {"BATT_ARM_VOLT": 12.0}},
]
UNASKED: list[dict[str, Any]] = [{}, {"charge": 1.0}, {"params": {"FS_GCS_ENABLE": 1, "BATT_MONITOR": 4}}]
TAKES = b"\0rc_12\0"


def scenario(autopilot: str, vehicle: dict[str, Any], **options: Any) -> Scenario:
    plan = {"square": {"side_m": 10, "alt_m": 10}}
    return Scenario.model_validate(
        {
            "name": "low-battery",
            "duration_s": 60,
            "origin": [-35.363328, 149.1652241],
            "autopilots": {"options": {autopilot: options} if options else {}},
            "operators": [{"id": "blue", "vehicles": [{"id": "b1", "autopilot": autopilot, "plan": plan, **vehicle}]}],
        }
    )


def use_build(folder: Path, monkeypatch: pytest.MonkeyPatch, more: bytes = b"") -> Path:
    path = folder / "arducopter"
    path.write_bytes(elf(body=firmware("ArduCopter V4.6.3") + b"no_time_sync\0" + more))
    path.chmod(0o755)
    monkeypatch.setenv(VARIABLE, str(path))
    return path


@pytest.mark.parametrize("vehicle", ASKED)
def test_what_a_build_does_not_take_is_said_with_its_cause(
    vehicle: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_build(tmp_path, monkeypatch)
    (name,) = vehicle.get("params", vehicle)
    for kind, options, why in (
        ("ardupilot", {}, "ArduCopter 4.6.3 measures SIM_BATT_VOLTAGE"),
        ("gazebo", {}, "ArduCopter 4.6.3 measures SIM_BATT_VOLTAGE"),
        ("ardupilot", {"physics": "native"}, "a battery of its own"),
    ):
        (line,) = list_battery_warnings(scenario(kind, vehicle, **options))
        assert line.startswith(f"blue/b1: {name} = ")
        assert why in line
    assert list_battery_warnings(scenario("builtin", vehicle)) == []


@pytest.mark.parametrize("vehicle", [*ASKED, *UNASKED])
def test_nothing_is_said_of_what_has_an_effect_or_is_not_asked(
    vehicle: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use_build(tmp_path, monkeypatch, b"" if vehicle in UNASKED else TAKES)
    assert list_battery_warnings(scenario("ardupilot", vehicle)) == []


def test_a_scenario_that_asks_nothing_needs_no_binary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "none"))
    assert list_battery_warnings(scenario("ardupilot", {})) == []


def test_a_build_shows_whether_it_takes_the_battery(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The battery's own keys are words that any build contains."""
    words = b"\0battery\0voltage\0current\0"
    assert BATTERY not in examine_binary(use_build(tmp_path, monkeypatch, words)).capabilities
    assert BATTERY in examine_binary(use_build(tmp_path, monkeypatch, words + TAKES)).capabilities


@pytest.mark.parametrize("command", ["run", "pair"])
def test_the_warning_comes_before_anything_else(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the flight, which a made-up binary ends: nothing was flown yet."""
    use_build(tmp_path, monkeypatch)
    changes = ["operators.*.vehicles.*.autopilot=ardupilot", "operators.*.vehicles.*.charge=0.3"]
    asked = [command, "rid-spoofing", *(f"--set={change}" for change in changes), "--out", str(tmp_path / "out")]
    said = CliRunner().invoke(app, asked)
    assert said.exit_code != 0
    first = said.stderr.splitlines()[0]
    assert first.startswith("WARNING: ")
    assert "charge = 0.3, but the autopilot does not measure the world's battery" in first


@settings(deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=14, max_size=14), st.floats(0.0, 1e6))
def test_lines_with_the_battery_are_what_percent_writes(row: list[float], time_s: float) -> None:
    (line,) = format_lines([time_s], Motion(np.array([row])))
    assert line == _BATTERY_LINE % (time_s, *row)
    voltage, current = (struct.unpack("<f", struct.pack("<f", value))[0] for value in row[12:])
    told = json.loads(line)["battery"]
    assert (told["voltage"], told["current"]) == (pytest.approx(voltage, rel=1e-5), pytest.approx(current, rel=1e-5))


def test_each_lines_battery_is_the_worlds_of_its_own_tick() -> None:
    sensors = StillWorld().sensors(slice(None))
    motion = to_ardupilot_motion(sensors, np.zeros(3), battery=True)
    assert motion.rows[:, 12:].tolist() == [[12.6, 8.0]] * 3
    assert to_ardupilot_motion(sensors, np.zeros(3)).rows.shape == STANDING.rows[[0] * 3].shape
    empty = Motion(motion.rows.copy())
    empty.rows[:, 12] = 9.9
    writer, steps = LineWriter(3, 2, battery=True), np.zeros(3, dtype=np.int64)
    two, none = np.full(3, 2), np.zeros(3, dtype=np.int64)
    writer.write(
        np.arange(3),
        first=none,
        per_tick=two,
        steps=steps,
        step_ns=np.full(3, 2_500_000),
        before=motion,
        after=empty,
    )
    for which in range(2):
        for row in range(3):
            line = json.loads(writer.text[which, row, : writer.lengths[which, row]].tobytes())
            assert line["battery"] == {"voltage": 9.9, "current": 8.0}
