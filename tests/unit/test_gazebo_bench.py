"""`gazebo-speed` of tools.agreement: summaries, tables and figure of measurements that were not made, and refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from tools.agreement.__main__ import app
from tools.agreement.gazebo_bench import collision, fleets
from tools.agreement.gazebo_bench.fleets import (
    TOO_SLOW,
    largest_in_real_time,
    measure_all,
    measure_fleets,
    summarise,
    versions,
)
from tools.agreement.gazebo_bench.page import draw, make_markdown

VERSIONS = {"gazebo": "Gazebo 11.1.0", "physics": "ode", "arducopter": "4.7.0-dev"}


def side(factor: float) -> dict[str, Any]:
    one = {"real_time_factor": factor, "ours_cpu_s": 0.1, "gazebo_cpu_s": 0.2, "autopilots_cpu_s": 0.3}
    return summarise([one])


def row(vehicles: int, factor: float, in_range: float = 8.0) -> dict[str, Any]:
    return {
        "vehicles": vehicles, "seconds": 5.0, "windows": 3, "window": False, "load": "light", "versions": VERSIONS,
        "gazebo": side(factor), "range": side(in_range), "slower": round(in_range / factor, 3),
    }  # fmt: skip


def collided(physics: str) -> dict[str, Any]:
    fell = {
        "lost_motors": [0, 2], "height_before_m": 30.0, "heights_after_m": [29.5, 26.7, 15.2], "fell_s": 3.01,
        "crashed": True, "tilt_after_deg": [1.0, 2.0, 3.0], "outcome": "failed",
    }  # fmt: skip
    flies = {**fell, "lost_motors": [], "fell_s": None}
    return {
        "physics": physics, "time_s": 34.92, "up_m": 30.2, "speed_mps": 9.97, "energy_j": 37.28,
        "aircraft": {"left/left": fell, "right/right": flies},
    }  # fmt: skip


def test_medians_of_the_windows() -> None:
    rows = [{"real_time_factor": factor, "ours_cpu_s": factor} for factor in (1.0, 4.0, 2.0)]
    assert summarise(rows) == {
        "real_time_factor": 2.0,
        "ours_cpu_s": 2.0,
        "inverse": 0.5,
        "factors": [1.0, 4.0, 2.0],
    }


@pytest.mark.parametrize(
    ("factors", "expected"),
    [
        ({5: 0.8}, {"measured": None, "interpolated": None}),
        ({1: 4.0, 5: 1.6}, {"measured": 5, "interpolated": None}),
        ({1: 4.0, 5: 1.25, 10: 0.625}, {"measured": 5, "interpolated": 6.2}),  # 0.8 + 0.2 of 0.8 in 5 aircraft
        ({10: 0.625, 1: 4.0, 5: 1.25}, {"measured": 5, "interpolated": 6.2}),
        ({1: 4.0, 5: 0.8, 10: 1.25}, {"measured": 1, "interpolated": 4.0}),  # noise does not make ten possible
        ({1: 4.0, 5: 1.0, 10: 0.5}, {"measured": 5, "interpolated": 5.0}),
    ],
)
def test_largest_number_in_real_time(factors: dict[int, float], expected: dict[str, Any]) -> None:
    rows = [{"vehicles": count, "gazebo": {"real_time_factor": factor}} for count, factor in factors.items()]
    assert largest_in_real_time(rows) == expected


def test_a_fleet_far_slower_than_real_time_is_the_last_one() -> None:
    asked: list[int] = []

    def measured(count: int) -> dict[str, Any]:
        asked.append(count)
        return row(count, 2.0 / count)

    shown: list[Any] = []
    rows = measure_fleets([10, 1, 5, 2, 5, 20], measured, shown.append)
    assert asked == [1, 2, 5, 10]
    assert rows == shown
    assert rows[-2]["gazebo"]["real_time_factor"] >= TOO_SLOW > rows[-1]["gazebo"]["real_time_factor"]


def test_versions_of_a_run() -> None:
    gazebo_facts = {"program": "/usr/bin/gz", "flavour": "sim", "version": "8.9.0", "physics": "dartsim"}
    manifest = {"engines": [{"kind": "gazebo", "version": "4.6.3", "gazebo": gazebo_facts}]}
    assert versions(manifest) == {"gazebo": "Gazebo Sim 8.9.0", "physics": "dartsim", "arducopter": "4.6.3"}


def document() -> dict[str, Any]:
    factors = {1: 3.0, 5: 1.25, 10: 0.625}
    return measure_all(list(factors), lambda count: row(count, factors[count]), collided)


def test_tables_of_the_document() -> None:
    text = make_markdown(json.loads(json.dumps(document())), "../images/gazebo.svg")
    assert "| 10 | 0.62 | 1.60 | 0.20 | 0.30 | 0.10 | 8.00 | 12.80 |" in text
    assert "In Gazebo, 5 aircraft run in real time, the largest such number measured; by interpolation" in text
    assert "In the range's own physics, at least 10 aircraft run in real time" in text
    assert "about 5 aircraft in Gazebo in real time, on 24 cores" in text
    assert "../images/gazebo.svg" in text
    assert "window, cores" not in text
    assert "front right, front left | 30.0 m | 29.5, 26.7, 15.2 m | 3.0 s |" in text
    assert "| none | 30.0 m | 29.5, 26.7, 15.2 m | still flying |" in text


def test_tables_tell_of_the_window() -> None:
    with_window = row(1, 2.0) | {"window": True}
    with_window["gazebo"]["window_cpu_s"] = 0.75
    text = make_markdown(measure_all([1], lambda count: with_window))
    assert "with Gazebo's window, on" in text
    assert "| 1 | 2.00 | 0.50 | 0.20 | 0.30 | 0.10 | 0.75 | 8.00 | 4.00 |" in text


def test_figure_marks_real_time_and_the_published_number() -> None:
    svg = draw(document()).svg
    ElementTree.fromstring(svg)
    assert "published, about 5" in svg
    assert "10 aircraft: 1.60" in svg
    assert "nan" not in svg.lower()


def test_collision_scenario_has_both_aircraft_on_one_line_without_noise() -> None:
    scenario = collision.collision_scenario("range", window=True)
    starts = [vehicle.start for _, vehicle in scenario.fleet]
    assert [start.east_m for start in starts] == [-30.0, 30.0]
    assert [start.north_m for start in starts] == [0.0, 0.0]
    assert scenario.sensors.noise == 0.0
    assert {vehicle.autopilot for _, vehicle in scenario.fleet} == {"ardupilot"}
    shown = collision.collision_scenario("gazebo", window=True)
    assert shown.autopilots.options["gazebo"] == {"window": True}


def test_command_without_gazebo_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("SKYRANGE_GAZEBO", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(fleets, "measure", lambda *_, **__: pytest.fail("it measured"))
    said = CliRunner().invoke(app, ["gazebo-speed"])
    assert said.exit_code != 0
    assert "neither gz nor gzserver" in str(said.exception or said.output)


def test_command_prints_and_writes_the_document(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    given: list[Any] = []

    def measure(vehicles: int, **more: Any) -> dict[str, Any]:
        given.append((vehicles, more))
        return row(vehicles, 2.0 / vehicles)

    monkeypatch.setattr(fleets, "require_gazebo", lambda *, window: None)
    monkeypatch.setattr(fleets, "measure", measure)
    monkeypatch.setattr(collision, "measure", lambda physics, window: collided(physics))
    output = tmp_path / "gazebo.json"
    asked = ["gazebo-speed", "--vehicles", "1", "--vehicles", "4", "--repeat", "2", "--output", str(output)]
    said = CliRunner().invoke(app, asked)
    assert said.exit_code == 0, said.output
    assert given[0] == (1, {"seconds": 5.0, "windows": 2, "load": "light", "rates": "full", "window": False})
    assert "in real time: 1 aircraft measured, interpolated 2.0" in said.stdout
    assert "collision in range: 9.97 m/s, 37.3 J" in said.stdout
    written = json.loads(output.read_text())
    assert [one["vehicles"] for one in written["rows"]] == [1, 4]
    told = json.loads(CliRunner().invoke(app, [*asked, "--no-collision", "--json"]).stdout)
    assert told["collisions"] == []
    assert told["real_time"]["gazebo"] == {"measured": 1, "interpolated": 2.0}
