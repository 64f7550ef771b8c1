"""ArduPilots fly by their own physics: on the machine's clock, seen by our world, and nothing of them stays."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skyrange.assembly.build import build
from skyrange.codec.mavlink import Packer, dialect
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.record import load
from skyrange.runtime.run import Run
from skyrange.scenario.toml_files import load_data
from tests.ardupilot import listening, needs_arducopter, programs

pytestmark = [pytest.mark.realtime, needs_arducopter]

SPEEDUP = 6.0


def scenario(duration_s: float = 80.0, head_on: bool = False, **changes: Any) -> Any:
    """Two of ArduPilot's own quadcopters and a builtin, each on a short leg and down again.

    `head_on`: the second and the builtin meet on a longer one, the builtin slow, so that they do whenever they start.
    """

    def vehicle(id_: str, autopilot: str, start: list[float], to: list[float], speed_mps: float = 4.0) -> Any:
        plan = {"path": {"points": [to], "alt_m": 3.0}, "speed_mps": speed_mps}
        return {"id": id_, "autopilot": autopilot, "start": start, "plan": plan}

    fleet = [
        vehicle("a1", "ardupilot", [0.0, 0.0], [0.0, 10.0]),
        vehicle("a2", "ardupilot", [30.0, 0.0], [0.0, 40.0 if head_on else 10.0]),
        vehicle("b1", "builtin", [60.0, 0.0], [0.0, 10.0]),
    ]
    if head_on:
        fleet[2] = vehicle("b1", "builtin", [30.0, 40.0], [0.0, -40.0], 1.0)
    options = {"ardupilot": {"physics": "native", "speedup": SPEEDUP}}
    return load_data(
        {
            "name": "native",
            "seed": 3,
            "duration_s": duration_s,
            "origin": {"lat": 40.778, "lon": -73.955},
            "operators": [{"id": "op", "vehicles": fleet}],
            **changes,
            "sensors": {"noise": 0.0 if head_on else 1.0},
            "autopilots": {"options": options, "on_silent": "continue"},
        }
    )


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("native") / "run"
    others = programs()
    run = Run.start(scenario(), folder)
    run.advance(0.0)
    assert len(programs() - others) == 2
    assert listening(programs() - others) == set()
    run.execute()
    assert programs() - others == set()
    return folder


def test_they_complete_their_missions_beside_a_builtin(flown: Path) -> None:
    outcomes = {vehicle: told["state"] for vehicle, told in load(flown).manifest["outcomes"].items()}
    assert outcomes == {"op/a1": "complete", "op/a2": "complete", "op/b1": "complete"}


def test_truth_is_theirs(flown: Path) -> None:
    truth = load(flown).table("truth")
    vehicle = np.array(truth.column("vehicle").to_pylist())
    source = np.array(truth.column("source").to_pylist())
    assert set(source[vehicle == "op/a1"]) == {"kinematic"}
    assert set(source[vehicle == "op/b1"]) == {"dynamic"}
    for name, east_m in (("op/a1", 0.0), ("op/a2", 30.0)):
        mine = vehicle == name
        place = np.column_stack([truth.column(axis).to_numpy()[mine] for axis in ("east_m", "north_m", "up_m")])
        np.testing.assert_allclose(place[0], (east_m, 0.0, 0.0), atol=0.05)
        np.testing.assert_allclose(place[-1], (east_m, 0.0, 0.0), atol=3.0)  # a landing by GNSS with its wander
        away = np.linalg.norm(place - (east_m, 10.0, 3.0), axis=1)
        reached_m = 2.0 + 3.0  # WPNAV_RADIUS, within which a waypoint counts as reached, and the wander of the GNSS
        assert away.min() < reached_m


def test_what_they_believe_is_what_our_receiver_tells(flown: Path) -> None:
    """GPS_INPUT is their only GNSS: none would have armed without, and their beliefs end where our truth does."""
    events = load(flown).table("events").to_pylist()
    armed = {row["about"]: row["time_ns"] for row in events if row["kind"] == "event.armed"}
    assert armed["op/a1"] < 30 * NS_PER_S
    assert not [row for row in events if row["kind"] == "event.glitch"]


def test_the_clocks_are_measured_and_the_pace_is_held(flown: Path) -> None:
    manifest = load(flown).manifest
    engine = next(row for row in manifest["engines"] if row["kind"] == "ardupilot")
    assert (engine["physics"], engine["speedup"]) == ("native", SPEEDUP)
    assert set(engine["skew_ms"]) == {"mean", "max", "between"}
    assert engine["skew_ms"]["mean"] > 0.0
    assert manifest["timings"]["real_time_factor"] < SPEEDUP * 1.1


def test_another_speed_is_refused_before_anything_starts(tmp_path: Path, before: set[int]) -> None:
    with pytest.raises(InputError, match="one speed"):
        Run.start(scenario(), tmp_path / "run", speed=2.0)
    assert not (tmp_path / "run").exists()


def test_one_that_dies_falls_and_one_that_hits_a_builtin_is_noted(tmp_path: Path, before: set[int]) -> None:
    """The builtin comes at a2 on its own line; a1 is killed in flight."""
    run = Run.start(scenario(40.0, head_on=True), tmp_path / "run")
    try:
        run.advance(0.0)
        mine = sorted(programs() - before)
        run.advance(9.0)
        os.kill(mine[0], signal.SIGKILL)
        run.advance(40.0)
    finally:
        run.finish()
    events = load(tmp_path / "run").table("events").to_pylist()
    a1 = [row["kind"] for row in events if row["about"] == "op/a1"]
    assert "event.engine_dead" in a1
    assert "event.crash" in a1
    assert "event.collision" in {row["kind"] for row in events}


def test_their_time_stands_still_while_we_do(tmp_path: Path, before: set[int]) -> None:
    run = Run.start(scenario(30.0), tmp_path / "run")
    try:
        run.advance(1.0)
        engine: Any = next(mount.engine for mount in run.built.wiring.engines if mount.engine.name == "ardupilot")
        clocks = [clock.reported_ns for clock in engine._clocks]
        time.sleep(4.0)  # 24 s of theirs
        run.advance(2.0)
        passed_s = [(clock.reported_ns - was) / NS_PER_S for clock, was in zip(engine._clocks, clocks, strict=True)]
        assert max(passed_s) < 12.0, "1 s, 0.25 s until they are stopped, and what a busy machine adds"
    finally:
        run.finish()


def test_none_outlives_skyrange_stopped_or_not(tmp_path: Path, before: set[int]) -> None:
    code = (
        "import time\n"
        "from pathlib import Path\n"
        "from skyrange.runtime.run import Run\n"
        "from tests.ardupilot import programs\n"
        "from tests.integration.test_ardupilot_native import scenario\n"
        f"run = Run.start(scenario(), Path({str(tmp_path / 'run')!r}))\n"
        "run.advance(0.5)\n"
        "print(*programs(), flush=True)\n"
        "time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    mine = [int(number) for number in process.stdout.readline().split()]
    assert len(mine) == 2
    time.sleep(1.0)  # by then they are stopped
    process.kill()
    process.wait()
    deadline = time.monotonic() + 10.0
    while any(Path(f"/proc/{pid}").exists() for pid in mine) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(Path(f"/proc/{pid}").exists() for pid in mine)


def test_attacks_on_its_sensors_are_refused() -> None:
    jump = {"vehicles": ["op/a2"], "offset_m": [30.0, 0.0, 0.0]}
    with pytest.raises(InputError, match="an aircraft that flies by the range's sensors"):
        build(scenario(30.0, attacks=[{"id": "lie", "kind": "gnss.jump", "start_s": 12.0, "params": jump}]))


def test_one_reboots_and_comes_back(tmp_path: Path, before: set[int]) -> None:
    run = Run.start(scenario(30.0), tmp_path / "run")
    try:
        run.advance(0.5)
        engine: Any = next(mount.engine for mount in run.built.wiring.engines if mount.engine.name == "ardupilot")
        reboot = dialect.MAVLink_command_long_message(
            1, 1, dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 0, 1, 0, 0, 0, 0, 0, 0
        )
        engine._instances[0].sitl.write(0, Packer(255, 190).pack(reboot))
        run.advance(20.0)
        assert engine._instances[0].alive
    finally:
        run.finish()
    events = load(tmp_path / "run").table("events").to_pylist()
    assert "event.reboot" in [row["kind"] for row in events if row["about"] == "op/a1"]
