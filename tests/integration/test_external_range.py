"""A vehicle that the range did not start flies in it: the builtin of another range behind a socket, and ArduPilot."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import mavutil

from skyrange.core.time import NS_PER_S
from skyrange.record import load
from skyrange.vehicle.ardupilot.parameters import NATIVE_PARAMETERS, RANGE_PARAMETERS
from tests.ardupilot import ARDUCOPTER, needs_arducopter
from tests.ports import OFFSET

pytestmark = pytest.mark.realtime

MAIN = "import sys; from skyrange.cli import main; sys.exit(main())"
ORIGIN = "[origin]\nlat = 40.778\nlon = -73.955\nalt_msl_m = 20.0\n"
PLAN = 'plan = { path = { points = [[0.0, 12.0]], alt_m = 5.0 }, end = "land" }'
FOREIGN = f"""
name = "foreign"
seed = 5
duration_s = 300
sensors = {{ noise = 0.0 }}
{ORIGIN}
[[operators]]
id = "blue"
vehicles = [{{ id = "b1", {PLAN} }}]
"""
RANGE = f"""
name = "range"
seed = 6
duration_s = {{seconds}}
{ORIGIN}
[radio]
[autopilots.options.external]
connect = {{{{ "blue/b1" = "{{connect}}" }}}}
allow_motion = true
[[operators]]
id = "blue"
vehicles = [{{{{ id = "b1", autopilot = "external", {PLAN.replace("{", "{{").replace("}", "}}")} }}}}]
[[operators]]
id = "green"
vehicles = [{{{{ id = "g1", start = [30.0, 0.0], {PLAN.replace("{", "{{").replace("}", "}}")} }}}}]
"""


def command(*words: str | Path) -> list[str]:
    return [sys.executable, "-c", MAIN, *map(str, words)]


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A live range of one aircraft whose proxy is left to others: its autopilot obeys whoever calls."""
    tmp_path = tmp_path_factory.mktemp("foreign")
    (tmp_path / "foreign.toml").write_text(FOREIGN)
    process = subprocess.Popen(
        command(
            "live", tmp_path / "foreign.toml", "--external", "blue/b1.proxy", "--group", "one",
            "--port-offset", str(OFFSET), "--out", tmp_path / "foreign", "--json",
        ),
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    part = tmp_path / "foreign" / ".parts" / "world"
    try:
        deadline = time.monotonic() + 150.0
        while not ((part / ".spool" / "truth-0000.arrows").exists() and load(part).rows("truth")):
            assert process.poll() is None, process.communicate()[1]
            assert time.monotonic() < deadline
            time.sleep(0.1)
        yield tmp_path / "foreign"
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=60.0)
        finally:
            process.kill()


def flown(folder: Path, connect: str, seconds: float, *options: str, how: str = "run") -> Any:
    (folder / "range.toml").write_text(RANGE.format(seconds=seconds, connect=connect))
    out = folder / "run"
    done = subprocess.run(
        command(how, folder / "range.toml", "--out", out, *options), capture_output=True, text=True, timeout=240
    )
    assert done.returncode == 0, done.stderr
    held = "interlock closed: blue/b1 cannot be armed or moved without --allow-motion" in done.stderr
    assert held is ("--allow-motion" not in options)
    return load(out)


def told(record: Any, vehicle: str = "blue/b1") -> list[tuple[str, dict[str, Any]]]:
    rows = record.table("events").to_pylist()
    return [(row["kind"], json.loads(row["data"])) for row in rows if row["about"] == vehicle]


def track(record: Any, vehicle: str = "blue/b1") -> np.ndarray[Any, Any]:
    """Rows of s, east, north, up."""
    rows = [row for row in record.table("truth").to_pylist() if row["vehicle"] == vehicle]
    return np.array([(row["time_ns"] / NS_PER_S, row["east_m"], row["north_m"], row["up_m"]) for row in rows])


def apart_m(seen: np.ndarray[Any, Any], true: np.ndarray[Any, Any]) -> tuple[float, float]:
    """The most that two tracks are apart, on the offset of their clocks that fits best, which is the second, s.

    The last flight of each is what is compared.
    """
    flights = [rows[rows[:, 3] > 0.5] for rows in (seen, true)]
    rough_s = flights[1][-1, 0] - flights[0][-1, 0]
    found = []
    for offset_s in np.arange(rough_s - 2.0, rough_s + 2.0, 0.01):
        on = [np.interp(seen[:, 0] + offset_s, true[:, 0], true[:, axis]) for axis in (1, 2, 3)]
        found.append((float(np.linalg.norm(np.column_stack(on) - seen[:, 1:], axis=1).max()), float(offset_s)))
    return min(found)


def heard(record: Any) -> set[tuple[str, str]]:
    rows = record.table("receptions").to_pylist()
    return {(row["sender"].partition(".")[0], row["receiver"]) for row in rows if row["outcome"] == "decoded"}


MOST_M = 0.2
"""Between what truth is there and what it is here, at 5 m/s and 10 reports a second; on an idle machine 0.02 m."""
OTHER = f"tcp:127.0.0.1:{5760 + OFFSET}"


def test_with_the_interlock_closed_it_is_seen_and_never_arms(foreign: Path, tmp_path: Path) -> None:
    closed = flown(tmp_path, OTHER, 29.0)
    assert {row["source"] for row in closed.table("truth").to_pylist() if row["vehicle"] == "blue/b1"} == {"external"}
    assert "event.armed" not in {kind for kind, _ in told(closed)}
    assert closed.outcomes["blue/b1"]["state"] == "failed"
    assert "mission upload: no answer" in closed.outcomes["blue/b1"]["reason"]
    refused = {row["message"] for row in closed.manifest["engines"][0]["vehicles"]["blue/b1"]["refused"]}
    assert {"MISSION_COUNT", "HEARTBEAT"} <= refused
    assert track(closed)[:, 3].max() < 0.1
    assert heard(closed) >= {("blue/b1", "green/g1"), ("green/g1", "blue/b1")}


def test_with_both_open_it_flies_its_mission_and_truth_is_where_it_is(foreign: Path, tmp_path: Path) -> None:
    flight = flown(tmp_path, OTHER, 38.0, "--allow-motion")
    kinds = [kind for kind, _ in told(flight)]
    order = [kinds.index(f"event.{kind}") for kind in ("armed", "takeoff", "landed", "disarmed")]
    assert order == sorted(order)
    assert flight.outcomes["blue/b1"]["state"] == "complete"
    assert flight.manifest["timings"]["real_time_factor"] == pytest.approx(1.0, abs=0.1)
    assert heard(flight) >= {("blue/b1", "green/g1"), ("green/g1", "blue/b1")}
    seen = track(flight)
    assert np.linalg.norm(seen[:, 1:] - (0.0, 12.0, 5.0), axis=1).min() < 1.0
    most_m, _ = apart_m(seen, track(load(foreign / ".parts" / "world")))
    assert most_m < MOST_M


def test_in_a_live_range_too(foreign: Path, tmp_path: Path) -> None:
    options = ("--allow-motion", "--group", "one", "--port-offset", str(OFFSET + 75))
    flight = flown(tmp_path, OTHER, 38.0, *options, how="live")
    assert flight.outcomes["blue/b1"]["state"] == "complete"
    assert {row["source"] for row in flight.table("truth").to_pylist() if row["vehicle"] == "blue/b1"} == {"external"}
    most_m, _ = apart_m(track(flight), track(load(foreign / ".parts" / "world")))
    assert most_m < MOST_M


COPTER = {
    name: value
    for name, value in (RANGE_PARAMETERS | NATIVE_PARAMETERS).items()
    if name not in ("GPS1_TYPE", "MAV2_OPTIONS", "DID_MAVPORT", "SIM_BARO_RND", "SIM_DRIFT_SPEED")
}
WARM_MS = 60_000


@pytest.fixture
def arducopter(tmp_path: Path) -> Iterator[str]:
    """An ArduPilot that nobody of ours started, whose estimator has settled; where it sends its MAVLink to."""
    assert ARDUCOPTER is not None
    own = tmp_path / "copter"
    own.mkdir()
    (own / "defaults.parm").write_text("".join(f"{name} {value:.9g}\n" for name, value in COPTER.items()))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = subprocess.Popen(
        [
            str(ARDUCOPTER.path), "--model", "x", "--home", "40.778,-73.955,20,0", "--defaults", "defaults.parm",
            "--speedup", "10", "--rc-in-port", str(port + 1 if port < 65_000 else port - 1),
            "--serial0", f"udpclient:127.0.0.1:{port}",
            *(part for number in (1, 2, 4, 5) for part in (f"--serial{number}", f"none:{number}")),
        ],
        cwd=own, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=254)
        deadline, speed, boot_ms = time.monotonic() + 60.0, 10.0, 0
        while speed != 1.0:
            assert time.monotonic() < deadline, (speed, boot_ms)
            said = link.recv_match(blocking=True, timeout=1.0)
            kind = said.get_type() if said is not None else ""
            if kind == "HEARTBEAT" and boot_ms == 0:
                link.mav.command_long_send(1, 1, 511, 0, 2, 100_000, 0, 0, 0, 0, 0)
            elif kind == "SYSTEM_TIME":
                boot_ms = said.time_boot_ms
                if boot_ms > WARM_MS:
                    link.mav.param_set_send(1, 1, b"SIM_SPEEDUP", 1.0, 9)
            elif kind == "PARAM_VALUE" and said.param_id == "SIM_SPEEDUP":
                speed = said.param_value
        link.close()
        yield f"udpin:127.0.0.1:{port}"
    finally:
        process.kill()
        process.wait()


@needs_arducopter
def test_an_arducopter_that_we_did_not_start_flies_its_mission_with_us(arducopter: str, tmp_path: Path) -> None:
    flight = flown(tmp_path, arducopter, 40.0, "--allow-motion")
    kinds = [kind for kind, _ in told(flight)]
    order = [kinds.index(f"event.{kind}") for kind in ("armed", "takeoff", "landed", "disarmed")]
    assert order == sorted(order)
    assert flight.outcomes["blue/b1"]["state"] == "complete"
    assert heard(flight) >= {("blue/b1", "green/g1"), ("green/g1", "blue/b1")}
    seen = track(flight)
    assert np.linalg.norm(seen[0, 1:]) < 1.5
    assert np.linalg.norm(seen[:, 1:] - (0.0, 12.0, 5.0), axis=1).min() < 2.0
    rows = [row for row in flight.table("truth").to_pylist() if row["vehicle"] == "blue/b1"]
    assert {row["source"] for row in rows} == {"external"}
