"""Comparison of flights in the range's own physics and in Gazebo's, of runs that were not flown, and its tables."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from typer.testing import CliRunner

from tools.agreement.__main__ import app
from tools.agreement.physics import comparison
from tools.agreement.physics.comparison import (
    Collision,
    ComparedScenario,
    FlownAircraft,
    PhysicsComparison,
    RunDifference,
    compare_aircraft,
    compare_runs,
    read_collisions,
)
from tools.agreement.physics.page import BEGIN, END, tables

TIME_S = np.arange(0.0, 10.0, 0.5)


def flown(east_mps: float = 1.0, outcome: str = "complete") -> FlownAircraft:
    """On the ground for 2 s, then 5 m high and eastward, and from 8 s on at rest on the ground again."""
    aloft = (TIME_S >= 2.0) & (TIME_S < 8.0)
    east_m = east_mps * np.clip(TIME_S - 2.0, 0.0, 6.0)
    zeros = np.zeros(len(TIME_S))
    return FlownAircraft(
        vehicle="blue/b1",
        airframe="iris",
        outcome=outcome,
        home_m=0.0,
        time_s=TIME_S,
        enu_m=np.stack([east_m, zeros, np.where(aloft, 5.0, 0.0)], axis=1),
        air_mps=np.zeros((len(TIME_S), 3)),
        velocity_mps=np.stack([np.where(aloft, east_mps, 0.0), zeros, zeros], axis=1),
        tilt_deg=np.where(aloft, 8.0, 0.0),
        charge=1.0 - 0.01 * TIME_S,
        on_ground=~aloft,
    )


def test_distances_are_those_at_equal_times() -> None:
    found = compare_aircraft((flown(1.0), flown(1.5)), (None, None))
    assert found.largest_m == pytest.approx(2.75)  # 0.5 m/s for 5.5 s; later both are on the ground
    assert found.largest_at_s == 7.5
    assert found.end_apart_m == pytest.approx(3.0)
    apart_m = 0.5 * (np.arange(2.0, 8.0, 0.5) - 2.0)
    assert found.rms_m == pytest.approx(np.sqrt((apart_m**2).mean()))
    assert found.measures["speed_max_mps"] == (1.0, 1.5)
    assert found.measures["landed_s"] == (7.5, 7.5)
    assert found.measures["lift_off_s"] == (2.0, 2.0)
    assert found.measures["charge_used"] == pytest.approx((0.095, 0.095))


def test_an_aircraft_that_collides_is_compared_until_then() -> None:
    found = compare_aircraft((flown(1.0), flown(2.0, "failed")), (None, 5.0))
    assert found.until_s == 5.0
    assert found.largest_at_s == 4.5
    assert found.largest_m == pytest.approx(2.5)
    assert "landed_s" not in found.measures
    assert found.measures["charge_used"][0] == pytest.approx(0.045)
    assert found.down_after_s == (None, 3.0)
    assert found.outcomes == ("complete", "failed")


def test_an_aircraft_that_never_takes_off_has_no_measures() -> None:
    resting = flown()
    still = FlownAircraft(
        resting.vehicle, resting.airframe, "unfinished", 0.0, TIME_S, np.zeros((len(TIME_S), 3)), resting.air_mps,
        np.zeros((len(TIME_S), 3)), np.zeros(len(TIME_S)), np.ones(len(TIME_S)), np.ones(len(TIME_S), dtype=bool),
    )  # fmt: skip
    assert compare_aircraft((still, still), (None, None)).measures == {}


def test_sliding_on_the_ground_is_measured_in_the_plane() -> None:
    one = flown()
    places = one.enu_m.copy()
    places[-1] += (0.3, 0.4, 0.7)  # after its landing
    slid = FlownAircraft(**{name: getattr(one, name) for name in one.__slots__} | {"enu_m": places})
    assert slid.standing_drift_m == pytest.approx(0.5)
    assert one.standing_drift_m == 0.0


def note(time_ns: int, about: str, other: str, kind: str = "event.collision") -> dict[str, Any]:
    data = {"with": other, "speed_mps": 10.0, "energy_j": 37.5, "east_m": 0.0, "north_m": 0.0, "up_m": 30.0}
    return {"time_ns": time_ns, "kind": kind, "about": about, "source": "world", "data": json.dumps(data), "causes": []}


class Record:
    """A run of one aircraft with these events."""

    def __init__(self, events: list[dict[str, Any]]) -> None:
        self.events = events
        self.outcomes = {"blue/b1": {"state": "complete"}}
        self.manifest = {
            "vehicles": [{"id": "blue/b1", "operator": "blue", "autopilot": "gazebo", "airframe": "iris", "plan": ""}]
        }

    def table(self, name: str, columns: list[str] | None = None) -> pa.Table:
        if name == "events":
            return pa.Table.from_pylist(self.events)
        assert columns is not None
        rows = {name: [0.0, 1.0] for name in columns} | {"vehicle": ["blue/b1"] * 2, "time_ns": [0, 1_000_000_000]}
        return pa.table({name: rows[name] for name in columns})


def test_a_collision_of_two_aircraft_is_told_once() -> None:
    record: Any = Record(
        [
            note(2_000_000_000, "green/g1", "blue/b1"),
            note(2_000_000_000, "blue/b1", "green/g1"),
            note(3_000_000_000, "green/g1", "building:4"),
            note(4_000_000_000, "blue/b1", "green/g1", "event.contact"),
        ]
    )
    assert read_collisions(record) == (
        Collision(2.0, "blue/b1", "green/g1", 10.0, 37.5, 30.0),
        Collision(3.0, "green/g1", "building:4", 10.0, 37.5, 30.0),
    )


def test_runs_are_compared_by_aircraft() -> None:
    calm: Any = Record([note(0, "blue/b1", "x", "event.armed")])
    found = compare_runs(calm, calm)
    assert [each.vehicle for each in found.aircraft] == ["blue/b1"]
    assert found.aircraft[0].largest_m == 0.0
    assert found.collisions == ((), ())


def compared() -> PhysicsComparison:
    hit = Collision(5.0, "blue/b1", "green/g1", 9.97, 37.3, 30.05)
    crashed = RunDifference((compare_aircraft((flown(1.0), flown(1.1, "failed")), (None, 5.0)),), ((), (hit,)))
    calm = RunDifference((compare_aircraft((flown(1.0), flown(1.02)), (None, None)),), ((), ()))
    squares = ComparedScenario("squares", "squares", 60.0, 1, calm, calm, calm)
    return PhysicsComparison(
        (squares, ComparedScenario("met", "met", 60.0, 2, crashed)),
        "Gazebo 11.1.0",
        "ode",
        "4.7.0-dev",
    )  # fmt: skip


def test_the_tables_have_versions_differences_and_collisions() -> None:
    page = "\n".join(tables(compared()))
    assert "Gazebo 11.1.0 with the physics engine ode, and ArduCopter 4.7.0-dev" in page
    assert "| largest distance in the air | 0.11 m at 7.5 s |" in page
    assert "| outcome | complete / failed |" in page
    assert "| range: none | | | | |" in page
    assert "| Gazebo: blue/b1 and green/g1 | 5.00 s | 9.97 m/s | 37.3 J | 30.05 m |" in page
    assert "| on the ground after the collision | none, 3.0 s |" in page
    assert "## Steps, and runs again" in page
    assert "RMS of 0.00 m/s" not in page  # still air has no gusts to tell of
    assert "-0.00" not in page
    for line in page.splitlines():
        assert not line.startswith("|") or line.endswith("|"), line


def test_command_writes_the_page_and_the_numbers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    given: list[Any] = []

    def compare(folder: Path, names: Any, changes: Any, **more: Any) -> PhysicsComparison:
        given.append((folder, names, changes, more["again"]))
        return compared()

    monkeypatch.setattr(comparison, "compare", compare)
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    asked = ["gazebo-physics", "met", "--out", str(tmp_path / "runs"), "--page", str(page), "--set", "seed=3"]
    said = CliRunner().invoke(app, [*asked, "--json"])
    assert said.exit_code == 0, said.output
    assert given == [(tmp_path / "runs", ["met"], ["seed=3"], "met")]
    told = json.loads(said.stdout)
    assert told["scenarios"][0]["difference"]["aircraft"][0]["largest_m"] == pytest.approx(0.11)
    made = "\n".join(tables(compared()))
    assert page.read_text() == f"before\n{BEGIN}\n\n{made}\n{END}\nafter\n"
    lines = CliRunner().invoke(app, asked, env={"COLUMNS": "200"}).stdout
    assert "## Largest differences" in lines


@pytest.mark.parametrize("text", [None, "# No marks\n"])
def test_a_page_without_marks_is_refused_first(tmp_path: Path, text: str | None) -> None:
    page = tmp_path / "page.md"
    if text is not None:
        page.write_text(text)
    said = CliRunner().invoke(app, ["gazebo-physics", "--page", str(page)])
    assert said.exit_code != 0
    assert "--page" in str(said.exception or said.output)


def test_comparison_refuses_before_anything_flies(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(comparison, "build", lambda scenario: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(comparison, "fly", lambda *_, **__: pytest.fail("it flew"))
    from skyrange.core.errors import InputError

    with pytest.raises(InputError, match="no-such-scenario"):
        comparison.compare(tmp_path, ["squares", "no-such-scenario"])
