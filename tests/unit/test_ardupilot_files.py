"""Files of ground stations that a scenario cannot take say what to do, and heights that may mislead are told."""

from __future__ import annotations

import io
import json
import subprocess
from pathlib import Path

import pytest
from rich.console import Console

from skyrange.assembly.run_header import _describe_mission_files
from skyrange.cli.output.run_summary import _print_mission_files
from skyrange.codec.mission import read_mission
from skyrange.codec.mission.fence_and_rally import ZONE_COMMANDS
from skyrange.codec.mission.ignored_keys import describe_mission_file
from skyrange.core.errors import InputError
from skyrange.scenario.toml_files import load_text, parse_toml

HOME = "0\t1\t0\t16\t0\t0\t0\t0\t47.3977\t8.5456\t408\t1"
SCENARIO = """
origin = [47.3977, 8.5456, {altitude}]
duration_s = 20
[[operators]]
id = "blue"
{params}
[[operators.vehicles]]
plan = {{ file = "given.plan", anchor = "{anchor}" }}
"""


@pytest.mark.parametrize("command", sorted(ZONE_COMMANDS))
def test_a_fence_list_is_no_mission(command: int, tmp_path: Path) -> None:
    path = tmp_path / "fence.waypoints"
    path.write_text(f"QGC WPL 110\n{HOME}\n1\t0\t3\t{command}\t4\t0\t0\t0\t47.398\t8.545\t0\t1\n")
    with pytest.raises(InputError, match=r"1 items of a fence.*fence\.polygons.*\.plan"):
        read_mission(path)


def test_a_fence_list_of_pairs_is_named(tmp_path: Path) -> None:
    path = tmp_path / "fence.txt"
    path.write_text("47.3977 8.5456\n47.398 8.545\n47.398 8.546\n47.397 8.546\n")
    with pytest.raises(InputError, match=r"fence list.*fence\.polygons"):
        read_mission(path)


@pytest.mark.parametrize("given", ['"my.param"', '{ file = "my.param" }'])
@pytest.mark.parametrize("vehicle", [False, True])
def test_a_param_file_is_converted_by_the_command_that_is_named(given: str, vehicle: bool, tmp_path: Path) -> None:
    text = SCENARIO.format(altitude=0, anchor="file", params="" if vehicle else f"params = {given}")
    with pytest.raises(InputError, match=r"my\.param.*a table of parameters") as error:
        load_text(text + (f"params = {given}\n" if vehicle else ""), "s")
    path = tmp_path / "my.param"
    path.write_text("# QGroundControl\nFENCE_ENABLE,1\nFENCE_TYPE 4\nRTL_ALT\t1500.5\n")
    [command] = [part for part in str(error.value).split("`") if part.startswith("awk")]
    lines = subprocess.run(["sh", "-c", command.replace("FILE", str(path))], capture_output=True, text=True, check=True)
    assert parse_toml(lines.stdout) == {"FENCE_ENABLE": 1, "FENCE_TYPE": 4, "RTL_ALT": 1500.5}


@pytest.mark.parametrize("anchor", ["file", "start"])
@pytest.mark.parametrize(("frame", "altitude", "told"), [(0, 0, 408), (0, 500, -92), (0, 400, None), (3, 0, None)])
def test_a_planned_home_at_another_altitude_is_told_where_it_matters(
    frame: int, altitude: int, told: int | None, anchor: str, tmp_path: Path
) -> None:
    items = [
        {"type": "SimpleItem", "doJumpId": number, "frame": frame, "command": command, "autoContinue": True,
         "params": [0, 0, 0, None, 47.3977, 8.5456, 428]}
        for number, command in enumerate((22, 16), 1)
    ]  # fmt: skip
    mission = {
        "version": 2, "firmwareType": 3, "vehicleType": 2, "plannedHomePosition": [47.3977, 8.5456, 408], "items": items
    }  # fmt: skip
    (tmp_path / "given.plan").write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": mission}))
    text = SCENARIO.format(altitude=altitude, anchor=anchor, params="")
    [row] = _describe_mission_files(load_text(text, "s", tmp_path))["mission_files"]
    assert row.get("planned_home_above_ground_m") == told
    words = describe_mission_file(row)
    assert ("planned with home" in words) == (told is not None)
    assert told is None or f"{abs(told)} m {'above' if told > 0 else 'below'}" in words
    console = Console(file=io.StringIO())
    _print_mission_files(console, [row])
    assert ("planned with home" in console.file.getvalue()) == (told is not None)  # type: ignore[attr-defined]
