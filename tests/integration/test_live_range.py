"""A live range of processes on real sockets: flies as in virtual time, with programs in it, and nothing of it stays."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from skyrange.core.time import NS_PER_S
from skyrange.record import load
from skyrange.study.runs import run
from tests.catalogue import in_turn
from tests.integration.live_agrees import fly_both
from tests.integration.live_programs import MAIN, killed_after, nodes, until
from tests.integration.test_live_agrees import SQUARES, assert_agrees
from tests.ports import OFFSET

pytestmark = pytest.mark.realtime

MAVPROXY = shutil.which("mavproxy.py")
MISSION = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t-35.363328\t149.1652241\t0\t1
1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t4\t1
2\t0\t3\t21\t0\t0\t0\t0\t0\t0\t0\t1
"""
"""Up to 4 m, and down again."""
SCENARIO = """
name = "live"
seed = 4
duration_s = {seconds}

[origin]
lat = -35.363328
lon = 149.1652241

[[operators]]
id = "blue"
vehicles = [{{ id = "b1", plan = {{ path = {{ points = [[0.0, 10.0]], alt_m = 5.0 }}, end = "land" }} }}]

[[operators]]
id = "green"
vehicles = [{{ id = "g1", start = [60.0, 0.0], plan = {{ path = {{ points = [[0.0, 10.0]], alt_m = 5.0 }} }} }}]
"""


def scenario(folder: Path, seconds: float) -> Path:
    path = folder / "live.toml"
    path.write_text(SCENARIO.format(seconds=seconds))
    return path


def started(folder: Path, seconds: float, *options: str) -> subprocess.Popen[str]:
    command = [
        sys.executable, "-c", MAIN, "live", str(scenario(folder, seconds)), "--out", str(folder / "run"),
        "--port-offset", str(OFFSET), *options,
    ]  # fmt: skip
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def fly_by_hand(port: int, process: subprocess.Popen[str]) -> dict[str, float]:
    """An operator's own program, in life: up to 4 m and down again; when, in s of the machine's clock.

    Fails at once where the range, `process`, has ended.
    """
    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=255)
    seen: dict[str, float] = {}
    try:
        until(lambda: link.wait_heartbeat(timeout=0.2), 120.0, "a heartbeat", process)
        seen["heard"] = time.monotonic()

        def command(number: int, *params: float) -> None:
            link.mav.command_long_send(1, 1, number, 0, *[*params, *[0.0] * 7][:7])

        def told(kind: str, holds: Callable[[Any], bool], again: Callable[[], None], seconds: float = 60.0) -> None:
            deadline = time.monotonic() + seconds
            asked = 0.0
            while time.monotonic() < deadline:
                assert process.poll() is None, process.communicate()
                if time.monotonic() > asked + 2.0:
                    asked = time.monotonic()
                    again()
                    link.mav.heartbeat_send(6, 8, 0, 0, 4)
                message = link.recv_match(type=kind, blocking=True, timeout=0.5)
                if message is not None and holds(message):
                    return
            raise AssertionError(f"no such {kind}")

        guided, landing = 4, 9
        armed = mavutil.mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        told("HEARTBEAT", lambda m: m.custom_mode == guided, lambda: command(176, 1, guided))
        command(511, 33, 100_000)  # GLOBAL_POSITION_INT at 10 Hz
        told("HEARTBEAT", lambda m: bool(m.base_mode & armed), lambda: command(400, 1))
        told("GLOBAL_POSITION_INT", lambda m: m.relative_alt > 3500, lambda: command(22, 0, 0, 0, 0, 0, 0, 4))
        seen["up"] = time.monotonic()
        told("HEARTBEAT", lambda m: m.custom_mode == landing, lambda: command(176, 1, landing))
        told("HEARTBEAT", lambda m: not m.base_mode & armed, lambda: None)
        seen["down"] = time.monotonic()
    finally:
        link.close()
    return seen


@in_turn("live ranges", "our station")
def test_it_flies_as_in_virtual_time_while_a_program_of_ours_is_a_ground_station(tmp_path: Path) -> None:
    process = started(tmp_path, 50.0, "--external", "green.gcs", "--json")
    try:
        fly_by_hand(14555 + 10 + OFFSET, process)
        out, err = process.communicate(timeout=150.0)
    finally:
        process.kill()
    assert process.returncode == 0, err
    facts = json.loads(out)
    assert facts["live"]["outside"] == ["green.gcs"]
    assert len(facts["live"]["nodes"]) == 7
    assert nodes(tmp_path) == {}
    live, twin = load(tmp_path / "run"), run(scenario(tmp_path, 50.0), tmp_path / "twin")
    assert live.manifest["status"] == "complete"
    assert live.manifest["timings"]["real_time_factor"] == pytest.approx(1.0, abs=0.1)

    def events(record: Any, about: str) -> list[tuple[str, float]]:
        rows = record.table("events").to_pylist()
        return [(row["kind"], row["time_ns"] / NS_PER_S) for row in rows if row["about"] == about]

    blue, theirs = events(live, "blue/b1"), events(twin, "blue/b1")
    assert [kind for kind, _ in blue] == [kind for kind, _ in theirs]
    assert max(abs(at - other) for (_, at), (_, other) in zip(blue, theirs, strict=True)) < 2.0
    assert live.outcomes["blue/b1"]["state"] == "complete"
    assert {"event.takeoff", "event.landed", "event.disarmed"} <= {kind for kind, _ in events(live, "green/g1")}
    frames = live.table("frames").to_pylist()
    kinds = {row["link"].partition(":")[0] for row in frames}
    assert kinds == {"gcs", "log", "autopilot", "rid_data", "approval"}
    ours = [row for row in frames if row["link"] == "gcs:green/g1" and row["sender"] == "outside"]
    assert len(ours) > 5
    assert all(row["fate"] == "delivered" for row in ours)
    blues = [row for row in frames if row["link"].endswith(":blue/b1") and row["fate"] == "delivered"]
    assert not any(row["sender"] == "outside" for row in blues)
    assert all(row["arrived_ns"] > row["sent_ns"] for row in blues)
    # a ground station that waits for its aircraft has nobody to speak to before it has heard from it
    heard_ns = min(row["arrived_ns"] for row in blues if row["link"].startswith("gcs:") and row["direction"] == "rev")
    lost = [row for row in frames if row["link"].endswith(":blue/b1") and row["fate"] == "lost"]
    assert all(row["sender"] == "blue.gcs" and row["sent_ns"] < heard_ns for row in lost)


def fly_by_mavproxy(port: int, folder: Path, process: subprocess.Popen[str]) -> list[str]:
    """As `fly_by_hand`, by commands at MAVProxy's console, and a mission uploaded before; what it said."""
    assert MAVPROXY is not None
    (folder / "up.txt").write_text(MISSION)
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "HOME": str(folder)}
    environment.pop("PYTHONPATH", None)  # it has its own Python
    console = subprocess.Popen(
        [MAVPROXY, f"--master=udpin:127.0.0.1:{port}", f"--state-basedir={folder}"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder, env=environment,
    )  # fmt: skip
    said: list[str] = []
    with killed_after(console, 120.0, process):
        for word, order in (
            ("Detected vehicle", f"wp load {folder / 'up.txt'}"),
            ("Loaded 3 waypoints", "mode GUIDED"),
            ("Mode GUIDED", "arm throttle"),
            ("ARMED", "mode AUTO"),
            ("Mode AUTO", "long 300 0 0"),
            ("DISARMED", ""),
        ):
            assert console.stdout is not None
            assert console.stdin is not None
            for line in console.stdout:
                said.append(line)
                if word in line:
                    break
            else:
                raise AssertionError(f"MAVProxy ended without {word!r}: {''.join(said)}")
            console.stdin.write(f"{order}\n")
            console.stdin.flush()
    return said


@in_turn("live ranges", "mavproxy")
@pytest.mark.external(missing="" if MAVPROXY else "mavproxy.py is not on PATH")
def test_mavproxy_is_an_operators_ground_station(tmp_path: Path) -> None:
    process = started(tmp_path, 55.0, "--external", "green.gcs", "--json")
    try:
        fly_by_mavproxy(14555 + 10 + OFFSET, tmp_path, process)
        _, err = process.communicate(timeout=150.0)
    finally:
        process.kill()
    assert process.returncode == 0, err
    rows = load(tmp_path / "run").table("events").to_pylist()
    kinds = [row["kind"] for row in rows if row["about"] == "green/g1"]
    assert kinds.index("event.mission") < kinds.index("event.armed") < kinds.index("event.takeoff")
    assert kinds.index("event.takeoff") < kinds.index("event.landed") < kinds.index("event.disarmed")


@in_turn("live ranges", "as in virtual time")
def test_the_same_happens_as_in_virtual_time(tmp_path: Path) -> None:
    both = fly_both("squares", tmp_path, OFFSET, 24.0)
    if both.facts["fell_behind"]:
        pytest.skip(f"this machine did not hold real time: {both.facts['late_max_s']}")
    assert_agrees(both, 24.0, SQUARES)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_nothing_of_it_outlives_it(tmp_path: Path, how: signal.Signals) -> None:
    process = started(tmp_path, 300.0)
    try:
        part = tmp_path / "run" / ".parts" / "world"
        spool = part / ".spool" / "truth-0000.arrows"  # it is there a moment before its first rows
        until(lambda: spool.exists() and load(part).rows("truth") > 0, 120.0, "flight", process)
        heard = ("blue.gcs", "world")
        until(lambda: all(load(part.with_name(one)).rows("frames") for one in heard), 20.0, "frames", process)
        process.send_signal(how)
        process.communicate(timeout=60.0)
        until(lambda: not nodes(tmp_path), 20.0, "no node left")
    finally:
        process.kill()
    if how is signal.SIGINT:
        assert process.returncode == 4
        record = load(tmp_path / "run")
        assert record.manifest["status"] == "interrupted"
        assert record.rows("truth") > 0
        assert not (tmp_path / "run" / ".parts").exists()
    else:
        parts = {path.parent.name: load(path.parent) for path in part.parent.glob("*/manifest.json")}
        assert parts["world"].rows("truth") > 0
        merged = [sys.executable, "-c", MAIN, "merge", str(tmp_path / "run"), "--json"]
        os.utime(spool)
        early = subprocess.run(merged, capture_output=True, text=True, check=False)
        assert (early.returncode, "still written to" in early.stderr) == (2, True), early.stderr
        # nobody writes any more, but that is known only some seconds later
        until(lambda: subprocess.run(merged, capture_output=True, check=False).returncode == 0, 20.0, "a whole record")
        whole = load(tmp_path / "run-merged")
        assert whole.manifest["status"] == "failed"
        assert whole.rows("truth") == parts["world"].rows("truth")
        assert whole.rows("frames") > max(one.rows("frames") for one in parts.values())
        assert whole.manifest["crossings"]["matched"] > 0
        assert {one["name"] for one in whole.manifest["nodes"]} > {"world", "blue.gcs", "blue/b1.proxy"}
        assert (whole.path / "scenario.toml").read_bytes() == (tmp_path / "run" / "scenario.toml").read_bytes()
        assert (whole.path / "report.html").exists()
        here = [*merged[:-2], "."]
        again = subprocess.run(here, capture_output=True, text=True, check=False, cwd=tmp_path / "run")
        assert (again.returncode, "run-merged" in again.stderr) == (2, True)
