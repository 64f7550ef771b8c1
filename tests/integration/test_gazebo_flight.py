"""Real ArduPilots fly in a real Gazebo: beside others, the same twice, into each other and into buildings."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skyrange.core.errors import ComponentError
from skyrange.record import RunRecord, load
from skyrange.runtime.run import Run
from skyrange.scenario.toml_files import load_data
from tests.ardupilot import programs
from tests.gazebo import GAZEBO, needs_gazebo, simulators

pytestmark = needs_gazebo

QUICK = {"SCHED_LOOP_RATE": 100}
"""Fewer exchanges with ArduPilot, a stated trade: a third of the time."""


@pytest.fixture(autouse=True)
def before() -> Iterator[set[int]]:
    """The Gazebos that ran before the test; none may be left by it."""
    others = simulators()
    yield others
    deadline = time.monotonic() + 10.0
    while (left := simulators() - others) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not left, "a Gazebo was left behind"


def vehicle(id_: str, autopilot: str, start: list[float], points: list[list[float]], **more: Any) -> dict[str, Any]:
    """An aircraft with a path, 4 m/s."""
    plan = {"path": {"points": points, "alt_m": more.pop("alt_m", 3.0)}, "speed_mps": 4.0}
    params = {} if autopilot == "builtin" else dict(QUICK)
    return {"id": id_, "autopilot": autopilot, "start": start, "plan": plan, "params": params, **more}


def scenario(fleet: list[dict[str, Any]], duration_s: float, **changes: Any) -> Any:
    """Aircraft of one operator, with ideal sensors."""
    return load_data(
        {
            "name": "gazebo",
            "seed": 3,
            "duration_s": duration_s,
            "origin": {"lat": 40.778, "lon": -73.955},
            "sensors": {"noise": 0.0},
            "operators": [{"id": "op", "vehicles": fleet}],
            **changes,
        }
    )


def mixed(duration_s: float = 80.0, **changes: Any) -> Any:
    """Two in Gazebo, one in the range's physics and a builtin, each on a short leg and down again."""
    kinds = ("gazebo", "ardupilot", "gazebo", "builtin")
    fleet = [
        vehicle(f"{kind[0]}{row}", kind, [20.0 * row, 0.0], [[0.0, 10.0]], airframe="x500" if row == 2 else "iris")
        for row, kind in enumerate(kinds)
    ]
    return scenario(fleet, duration_s, wind={"speed_mps": 3.0, "from_deg": 270.0, "turbulence": "light"}, **changes)


def fly(scenario: Any, folder: Path) -> RunRecord:
    """Fly it to its end."""
    Run.start(scenario, folder).execute()
    return load(folder)


def events(record: RunRecord, kind: str) -> list[tuple[str, dict[str, Any]]]:
    """Subject and data of the events of a kind."""
    return [(r["about"], json.loads(r["data"])) for r in record.table("events").to_pylist() if r["kind"] == kind]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> RunRecord:
    return fly(mixed(), tmp_path_factory.mktemp("mixed") / "run")


def test_all_kinds_fly_their_missions_in_one_run(flown: RunRecord) -> None:
    outcomes = {vehicle: told["state"] for vehicle, told in flown.manifest["outcomes"].items()}
    assert set(outcomes.values()) == {"complete"}, outcomes
    assert len(outcomes) == 4
    engines = {engine["kind"]: engine for engine in flown.manifest["engines"]}
    assert GAZEBO is not None
    assert engines["gazebo"]["gazebo"]["version"] == GAZEBO.version
    assert engines["gazebo"]["gazebo"]["physics"]
    truth = flown.table("truth").to_pandas()
    assert dict(zip(truth["vehicle"], truth["source"], strict=True)) == {
        "op/g0": "simulator", "op/a1": "dynamic", "op/g2": "simulator", "op/b3": "dynamic",
    }  # fmt: skip


def test_in_gazebo_it_flies_as_in_the_physics_of_the_range(tmp_path: Path) -> None:
    air = {"speed_mps": 4.0, "from_deg": 270.0, "turbulence": "light"}
    tracks = []
    for kind in ("gazebo", "ardupilot"):
        one = vehicle("one", kind, [0.0, 0.0], [[0.0, 10.0], [10.0, 0.0]], alt_m=8.0)
        truth = fly(scenario([one], 25.0, wind=air), tmp_path / kind).table("truth").to_pandas()
        tracks.append(truth[["east_m", "north_m", "up_m"]].to_numpy())
    # same turbulence: what remains is one tick of delay, and how the gear grips the ground. RTL begins after 25 s, with
    # decisions that a centimetre moves by half a second
    assert np.linalg.norm(tracks[0] - tracks[1], axis=1).max() < 0.25
    assert np.ptp(tracks[0], axis=0).min() > 7.0


def test_the_same_twice_to_the_byte(flown: RunRecord, tmp_path: Path) -> None:
    assert fly(mixed(), tmp_path / "again").manifest["digests"] == flown.manifest["digests"]


@pytest.mark.parametrize("other", ["gazebo", "builtin"])
def test_two_that_meet_collide_and_fall(other: str, tmp_path: Path) -> None:
    fleet = [
        vehicle("one", "gazebo", [-20.0, 0.0, 90.0], [[0.0, 0.0], [40.0, 0.0]], alt_m=10.0),
        vehicle("two", other, [20.0, 0.0, 270.0], [[0.0, 0.0], [-40.0, 0.0]], alt_m=10.0),
    ]
    record = fly(scenario(fleet, 30.0), tmp_path / "run")
    met = events(record, "event.collision")
    assert [(about, data["with"]) for about, data in met[:2]] == [("op/one", "op/two"), ("op/two", "op/one")]
    assert met[0][1]["speed_mps"] == pytest.approx(8.0, abs=0.5)
    assert met[0][1]["energy_j"] > 10.0
    assert abs(met[0][1]["east_m"]) < 3.0
    assert met[0][1]["up_m"] == pytest.approx(10.2, abs=1.0)
    truth = record.table("truth").to_pandas()
    for name in ("op/one", "op/two"):
        track = truth[truth["vehicle"] == name]
        assert track["up_m"].iloc[-1] < 1.0, f"{name} did not fall"
        assert track["east_m"].abs().max() < 30.0


def test_a_building_stops_an_aircraft(tmp_path: Path) -> None:
    wall = {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "properties": {"height": 30},
                "geometry": {"type": "Polygon", "coordinates": [_around(25.0, 0.0, 5.0, 20.0)]},
            }
        ],
    }
    (tmp_path / "wall.geojson").write_text(json.dumps(wall))
    fleet = [vehicle("one", "gazebo", [0.0, 0.0, 90.0], [[0.0, 0.0], [60.0, 0.0]], alt_m=8.0)]
    given = scenario(fleet, 30.0, city={"buildings": str(tmp_path / "wall.geojson")})
    record = fly(given, tmp_path / "run")
    ((about, data),) = events(record, "event.collision")
    assert (about, data["with"]) == ("op/one", "building:0")
    assert data["east_m"] == pytest.approx(20.0, abs=0.6)
    truth = record.table("truth").to_pandas()
    assert truth["east_m"].max() < 20.0
    assert truth["up_m"].iloc[-1] < 0.5


def _around(east_m: float, north_m: float, half_m: float, long_m: float) -> list[list[float]]:
    """A rectangle about a place, as longitude and latitude."""
    from skyrange.core.geodesy import Origin

    origin = Origin(40.778, -73.955, 0.0)
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    places = [origin.geodetic_of(east_m + x * half_m, north_m + y * long_m) for x, y in corners]
    return [[lon, lat] for lat, lon in places]


def test_a_motor_fault_reaches_gazebo(tmp_path: Path) -> None:
    fleet = [vehicle("one", "gazebo", [0.0, 0.0], [[0.0, 40.0]], alt_m=10.0)]
    faults = [{"id": "loss", "kind": "motor.loss", "params": {"vehicles": ["op/one"], "motor": 1}, "start_s": 12.0}]
    record = fly(scenario(fleet, 20.0, faults=faults), tmp_path / "run")
    assert [about for about, _ in events(record, "event.crash")] == ["op/one"]


def test_a_gazebo_that_dies_is_named_and_the_record_stays(tmp_path: Path, before: set[int]) -> None:
    run = Run.start(mixed(), tmp_path / "run")
    run.advance(3.0)
    for pid in simulators() - before:
        os.kill(pid, signal.SIGKILL)
    with pytest.raises(ComponentError, match="engine gazebo: ended"):
        run.execute()
    record = load(tmp_path / "run")
    assert record.manifest["status"] == "failed"
    assert record.rows("truth") > 20


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_none_outlives_skyrange(tmp_path: Path, before: set[int], how: signal.Signals) -> None:
    others = programs()
    code = (
        "from pathlib import Path\n"
        "from tests.integration.test_gazebo_flight import mixed\n"
        "from skyrange.runtime.run import Run\n"
        f"Run.start(mixed(3000.0), Path({str(tmp_path / 'run')!r})).execute()\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 180.0
    while not simulators() - before and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(1.0)
    assert simulators() - before
    process.send_signal(how)
    process.wait(30.0)
    deadline = time.monotonic() + 10.0
    while (programs() - others or simulators() - before) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not programs() - others
    assert not simulators() - before
