"""Do real programs take part in a live range? Ground stations, viewers, an attacker's script, Wireshark."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from skyrange.core.time import NS_PER_S
from tests.integration.live_programs import (
    CLIENTS,
    LAT,
    LON,
    MAVPROXY,
    ONE_AIRCRAFT,
    beside,
    client,
    heard,
    kinds,
    live,
    mavsdk_python,
    needs_mavproxy,
)

pytestmark = pytest.mark.integration

OFFSET = 2000 + os.getpid() % 400 * 10
"""So that two test runs on one machine are out of each other's way."""


def test_mavsdk_is_an_operators_ground_station(tmp_path: Path) -> None:
    python = mavsdk_python()
    with live(tmp_path, ONE_AIRCRAFT.format(seconds=38), OFFSET, "--external", "blue.gcs", "--group", "one") as flight:
        station = client(python, "mavsdk_station.py", 14555 + OFFSET, LAT, LON)
        assert station.returncode == 0, station.stdout + station.stderr
        words = [line.split()[0] for line in station.stdout.splitlines() if line.split()[0].islower()]
        assert words == ["found", "uploaded", "armed", "flies", "landed"]
        assert "uploaded 4" in station.stdout
        facts, record = flight.landed()
    assert facts["live"]["outside"] == ["blue.gcs"]
    told = kinds(record, "blue/b1")
    order = ["event.mission", "event.armed", "event.takeoff", "event.landed", "event.disarmed"]
    assert [kind for kind in told if kind in order] == order
    frames = record.table("frames").to_pylist()
    theirs = [row for row in frames if row["link"] == "gcs:blue/b1" and row["direction"] == "fwd"]
    assert len(theirs) > 10
    assert {row["sender"] for row in theirs} == {"outside"}


FAILSAFE = ONE_AIRCRAFT.replace("depart_s = 1", "depart_s = 1, params = {{ FS_GCS_ENABLE = 1 }}")


def watch_by_mavproxy(console: subprocess.Popen[str], port: int) -> None:
    """Mode and position; what it orders is not obeyed."""
    assert console.stdin is not None
    heard(console, "Detected vehicle 1:1")
    heard(console, "Mode AUTO")
    heard(console, "Mission: 2")
    console.stdin.write("arm throttle\nmode LAND\nstatus GLOBAL_POSITION_INT\n")
    console.stdin.flush()
    at_the_site(heard(console, r"GLOBAL_POSITION_INT {.*lat : (-?\d+), lon : (-?\d+)"))


def watch_by_mavsdk(console: subprocess.Popen[str], port: int) -> None:
    at_the_site(heard(console, r"SEEN lat (-?\d+) lon (-?\d+)"))


def at_the_site(found: re.Match[str]) -> None:
    assert abs(int(found[1]) / 1e7 - LAT) < 0.01
    assert abs(int(found[2]) / 1e7 - LON) < 0.01


@pytest.mark.parametrize("who", [pytest.param("mavproxy", marks=needs_mavproxy), "mavsdk"])
def test_viewers_see_all_and_are_heard_by_nobody(who: str, tmp_path: Path) -> None:
    port = 5763 + OFFSET
    if who == "mavproxy":
        command = [str(MAVPROXY), f"--master=tcp:127.0.0.1:{port}", f"--state-basedir={tmp_path}"]
        watch = watch_by_mavproxy
    else:
        command, watch = [mavsdk_python(), str(CLIENTS / "mavsdk_viewer.py"), str(port)], watch_by_mavsdk
    scenario = FAILSAFE.format(seconds=26)
    with live(tmp_path, scenario, OFFSET, "--qgc", "--group", "component", "--on-death", "continue") as flight:
        flight.flying()
        with beside(command, tmp_path) as console:
            watch(console, port)
            flight.kill("blue.gcs")
            # its own heartbeats go on: they would hide that the station is lost
            heard(console, "GCS Failsafe")
            _, record = flight.landed()
    came = re.search(r"viewers: 1 came and sent ([\d,]+) bytes that nobody heard", flight.said)
    assert came is not None, flight.said
    assert int(came[1].replace(",", "")) > 100
    assert record.manifest["live"]["viewers"] == {"blue/b1": f"tcp://127.0.0.1:{port}"}
    assert record.manifest["crossings"]["outside"] == 0
    frames = list(record.frames_with_payloads())
    assert not any(frame.sender == "outside" for frame in frames)
    last = max(frame.arrived_ns or 0 for frame in frames if frame.link == "gcs:blue/b1" and frame.direction == "fwd")
    fail = [frame.sent_ns for frame in frames if frame.link == "autopilot:blue/b1" and b"GCS Failsafe" in frame.payload]
    assert 4.0 < (fail[0] - last) / NS_PER_S < 7.0  # FS_GCS_TIMEOUT is 5 s, and the last beat was up to 1 s before
    modes = [row["data"] for row in record.table("events").to_pylist() if row["kind"] == "event.mode"]
    assert not any('"LAND"' in data for data in modes)
