"""MAVProxy and MAVSDK watch a run, where they are installed: they find the aircraft, its mode and its position."""

from __future__ import annotations

import asyncio
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Timer

import pytest

from tests.ardupilot import needs_arducopter
from tests.integration.watched_range import ONE, START_S, alone, range_of
from tests.tiers import needs_mavproxy

pytestmark = [pytest.mark.realtime, pytest.mark.external]
MAVPROXY = shutil.which("mavproxy.py")
AUTOPILOTS = ["builtin", pytest.param("ardupilot", marks=needs_arducopter)]


class Console:
    """MAVProxy with its console in our hands."""

    def __init__(self, port: int, folder: Path) -> None:
        assert MAVPROXY is not None
        environment = {**os.environ, "PYTHONUNBUFFERED": "1", "HOME": str(folder)}
        environment.pop("PYTHONPATH", None)  # it has its own Python
        self.program = subprocess.Popen(
            [MAVPROXY, f"--master=tcp:127.0.0.1:{port}", f"--state-basedir={folder}"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder,
            env=environment,
        )  # fmt: skip
        self.heard = ""

    def order(self, words: str) -> None:
        assert self.program.stdin is not None
        self.program.stdin.write(f"{words}\n")
        self.program.stdin.flush()

    def until(self, pattern: str) -> re.Match[str]:
        """Its next line in which `pattern` is found."""
        assert self.program.stdout is not None
        for line in self.program.stdout:
            self.heard += line
            if found := re.search(pattern, line):
                return found
        raise AssertionError(f"MAVProxy ended without {pattern!r}; it said:\n{self.heard}")


@contextmanager
def mavproxy(port: int, folder: Path) -> Iterator[Console]:
    console = Console(port, folder)
    ends = Timer(START_S, console.program.kill)
    ends.start()
    try:
        yield console
    finally:
        ends.cancel()
        console.program.kill()
        console.program.communicate()


@needs_mavproxy
@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_mavproxy_tells_mode_and_position(autopilot: str, tmp_path: Path) -> None:
    with range_of(tmp_path, alone(90.0, autopilot=autopilot)) as (_, ports), mavproxy(ports[ONE], tmp_path) as console:
        console.until("Detected vehicle 1:1 on link 0")
        console.until("Mode AUTO")
        console.until("Mission: 3 WP")
        console.order("arm throttle")
        console.order("mode LAND")
        console.order("status GLOBAL_POSITION_INT")
        at = console.until(r"GLOBAL_POSITION_INT {.*lat : (-?\d+), lon : (-?\d+), .*relative_alt : (-?\d+)")
        assert abs(int(at[1]) / 1e7 + 35.3633) < 0.01
        assert abs(int(at[2]) / 1e7 - 149.1652) < 0.01
        assert 3_000 < int(at[3]) < 7_000  # the square is at 5 m
        console.until("Mission: 5 WP")  # it flies on, and does not land
        assert "Mode LAND" not in console.heard


@pytest.mark.parametrize("autopilot", AUTOPILOTS)
def test_mavsdk_tells_mode_and_position(autopilot: str, tmp_path: Path) -> None:
    mavsdk = pytest.importorskip("mavsdk", reason="MAVSDK for Python is not installed")
    if not hasattr(mavsdk, "Mavsdk"):
        pytest.skip("MAVSDK for Python before 4 is another interface")
    from mavsdk.asyncio import Mavsdk
    from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
    from mavsdk.plugins.telemetry import FlightMode

    async def watch(port: int) -> None:
        station = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION)
        async with Mavsdk(station) as sdk:
            await sdk.add_any_connection(f"tcpout://127.0.0.1:{port}")
            system = await sdk.first_autopilot(timeout_s=START_S)
            assert system is not None
            telemetry = TelemetryAsync(system)
            async for mode in telemetry.subscribe_flight_mode():
                if mode == FlightMode.MISSION:
                    break
            async for at in telemetry.subscribe_position():
                assert abs(at.latitude_deg + 35.3633) < 0.01
                assert abs(at.longitude_deg - 149.1652) < 0.01
                if at.relative_altitude_m > 3.0:
                    break
            telemetry.destroy()

    with range_of(tmp_path, alone(90.0, autopilot=autopilot)) as (_, ports):
        asyncio.run(asyncio.wait_for(watch(ports[ONE]), START_S))
