"""Mission files that are compared between two kinds of autopilot: read, moved, checked, far enough apart."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Frame
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.parity.missions import comparison as mission_parity
from skyrange.parity.missions.comparison import MissionAgreement, given_missions, page, results
from skyrange.parity.missions.flights import (
    KINDS,
    ORIGIN,
    ComparedMission,
    _reached_items,
    fleet_scenario,
)
from skyrange.parity.missions.mission_sources import read_missions

FILE = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.0\t8.0\t400\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t10\t1
2\t0\t0\t16\t0\t0\t0\t0\t{lat}\t8.0\t420\t1
3\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1
"""


def mission_file(folder: Path, name: str, lat: float = 47.001) -> Path:
    file = folder / name
    file.write_text(FILE.format(lat=lat))
    return file


def test_a_mission_is_moved_to_the_start_with_altitudes_above_it(tmp_path: Path) -> None:
    ((mission,), _) = read_missions([mission_file(tmp_path, "a.waypoints")])
    placed = mission.at(ORIGIN, (2_000.0, 0.0)).items[1]
    east_m, north_m = ORIGIN.enu_of(placed.x, placed.y)
    assert (east_m, placed.z) == pytest.approx((2_000.0, 20.0), abs=0.1)
    assert north_m == pytest.approx(111.2, abs=0.5)
    assert placed.frame == mav.MAV_FRAME_GLOBAL_RELATIVE_ALT
    assert mission.commands == (22, 16, 20)
    assert mission.words.endswith("a.waypoints")


def unflyable(folder: Path) -> dict[Path, str]:
    """Files that cannot be read, flown or placed, and what their refusal says."""
    files = {
        folder / "none.waypoints": "no such file",
        folder / "text.waypoints": "QGC WPL",
        folder / "grounded.waypoints": "expected 22",
        folder / "far.waypoints": "from home",
    }
    text, grounded, far = [*files][1:]
    text.write_text("not a mission\n")
    grounded.write_text(FILE.format(lat=47.001).replace("\t22\t", "\t16\t"))
    far.write_text(FILE.format(lat=57.001))
    return files


def test_a_file_that_cannot_be_flown_does_not_keep_the_others_down(tmp_path: Path) -> None:
    bad = unflyable(tmp_path)
    first, last = (mission_file(tmp_path, name) for name in ("a.waypoints", "z.waypoints"))
    flown, refused = given_missions([first, *bad, last])
    assert [mission.file for mission in flown] == [first, last]
    assert [mission.number for mission in flown] == [1, len(bad) + 2]
    assert [one.file for one in refused] == [*bad]
    for one in refused:
        assert bad[one.file] in one.reason, one
    found = MissionAgreement((), {}, tuple(refused))
    lines = list(page(found))
    assert f"{len(bad)} missions: 0 flown, {len(bad)} refused. 0 undecided." in lines
    assert [row["file"] for row in results(found)["refused"]] == [str(file) for file in bad]


def test_the_command_says_the_count_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = unflyable(tmp_path)
    flights: list[int] = []

    def compare_fleet(folder: Path, missions: Sequence[Any], *_: Any, **__: Any) -> list[ComparedMission]:
        flights.append(len(missions))
        return []

    monkeypatch.setattr(mission_parity, "compare_fleet", compare_fleet)
    asked = ["parity", "missions", str(mission_file(tmp_path, "a.waypoints")), *map(str, bad), "--out"]
    said = CliRunner().invoke(app, [*asked, str(tmp_path / "out")])
    assert said.exit_code == 0, said.output
    lines = said.stderr.splitlines()
    assert lines[0] == f"{len(bad) + 1} missions: 1 flown, {len(bad)} refused."
    assert [line for line in lines if line.startswith("not flown: ")] == lines[1 : len(bad) + 1]
    assert flights == [1]


def test_nothing_flies_if_no_file_can(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a mission that can be flown") as error:
        given_missions([*unflyable(tmp_path)])
    assert len(error.value.problems) == len(unflyable(tmp_path))


def test_missions_that_lead_far_start_farther_apart(tmp_path: Path) -> None:
    missions, _ = read_missions([mission_file(tmp_path, "far.waypoints", 47.01)] * 2)
    scenario = fleet_scenario(missions, (0.0, 0.0), tmp_path)
    starts = sorted(vehicle.start.east_m for _, vehicle in scenario.fleet)
    assert len(starts) == 2 * len(KINDS)
    assert min(b - a for a, b in itertools.pairwise(starts)) > 2_000.0


def test_items_count_as_reached_from_lift_off_to_touchdown_and_by_their_autopilot_alone() -> None:
    autopilots = {name: Packer(1, 1) for name in ("a/1", "b/1")}

    reached, current = mav.MAVLink_mission_item_reached_message, mav.MAVLink_mission_current_message

    def report(at_s: float, seq: int, vehicle: str = "a/1", sender: str = "autopilot", message: Any = reached) -> Frame:
        ends = f"{vehicle}.{sender}", f"{vehicle}.proxy"
        payload = autopilots[vehicle].pack(message(seq))
        return Frame(f"autopilot:{vehicle}", "fwd", ends[0], 0, *ends, sent_ns=round(at_s * NS_PER_S), payload=payload)

    frames = [
        report(9.9, 1), report(10.0, 2), report(12.5, 3), report(13.0, 9, sender="proxy"),
        report(14.0, 3, message=current), report(20.0, 4), report(20.1, 5), report(31.0, 1, "b/1"),
    ]  # fmt: skip
    record: Any = SimpleNamespace(frames_with_payloads=lambda: iter(frames))
    found = _reached_items(record, {"a/1": (10.0, 20.0), "b/1": (30.0, 40.0)})
    assert found == {"a/1": [(0.0, 2), (2.5, 3), (10.0, 4)], "b/1": [(1.0, 1)]}
