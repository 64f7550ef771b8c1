"""An operator's ground station of MAVSDK: `mavsdk_station.py PORT LAT LON` uploads a mission, arms, flies, lands.

Runs on its own, by a Python that has MAVSDK 4 or later; says what it has reached, a word a line.
"""

import asyncio
import sys
from collections.abc import AsyncIterator, Callable
from typing import Any

from mavsdk import ComponentType, Configuration
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.mission_raw import MissionItem

STEP_S = 60.0
NORTH_1E7 = 540
"""6 m of latitude, in 1e-7 degrees."""


async def until(stream: AsyncIterator[Any], holds: Callable[[Any], bool]) -> None:
    async def heard() -> None:
        async for one in stream:
            if holds(one):
                return

    await asyncio.wait_for(heard(), STEP_S)


async def again(deed: Callable[[], Any]) -> None:
    """Until it is accepted: an autopilot that has just booted refuses for a while."""
    for left in range(20, -1, -1):
        try:
            await deed()
            return
        except Exception:
            if not left:
                raise
            await asyncio.sleep(1.0)


def mission(lat: float, lon: float) -> list[MissionItem]:
    north, east = round(lat * 1e7), round(lon * 1e7)
    home, take_off, waypoint, land = (0, 16), (3, 22), (3, 16), (3, 21)
    places = [(home, 0, 0.0), (take_off, 0, 4.0), (waypoint, NORTH_1E7, 4.0), (land, NORTH_1E7, 0.0)]
    return [
        MissionItem(
            seq=seq, frame=frame, command=command, autocontinue=1, current=int(seq == 0), x=north + more, y=east, z=up
        )
        for seq, ((frame, command), more, up) in enumerate(places)
    ]


async def main(port: int, lat: float, lon: float) -> None:
    station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(station) as sdk:
        await sdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = await sdk.first_autopilot(timeout_s=120.0)
        assert system is not None, "no autopilot"
        print("found", flush=True)
        telemetry, action, missions = TelemetryAsync(system), ActionAsync(system), MissionRawAsync(system)
        await again(lambda: missions.upload_mission(mission(lat, lon)))
        print("uploaded", len(await missions.download_mission()), flush=True)
        await again(action.arm)
        print("armed", flush=True)
        await again(missions.start_mission)
        await until(telemetry.subscribe_position(), lambda at: at.relative_altitude_m > 3.0)
        print("flies", flush=True)
        await until(telemetry.subscribe_armed(), lambda armed: not armed)
        print("landed", flush=True)
        for plugin in (telemetry, action, missions):
            plugin.destroy()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])))
