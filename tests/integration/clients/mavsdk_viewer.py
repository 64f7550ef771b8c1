"""MAVSDK watches: `mavsdk_viewer.py PORT` waits for mode and position, tries to land the aircraft, says what came.

Runs on its own, by a Python that has MAVSDK 4 or later, and stays until it is killed.
"""

import asyncio
import sys

from mavsdk import ComponentType, Configuration
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.telemetry import FlightMode


async def main(port: int) -> None:
    station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(station) as sdk:
        await sdk.add_any_connection(f"tcpout://127.0.0.1:{port}")
        system = await sdk.first_autopilot(timeout_s=120.0)
        assert system is not None, "no autopilot"
        telemetry = TelemetryAsync(system)
        async for mode in telemetry.subscribe_flight_mode():
            if mode == FlightMode.MISSION:
                break
        async for at in telemetry.subscribe_position():
            if at.relative_altitude_m > 3.0:
                print(f"SEEN lat {round(at.latitude_deg * 1e7)} lon {round(at.longitude_deg * 1e7)}", flush=True)
                break
        try:
            await ActionAsync(system).land()
        except Exception as refused:
            print(f"not obeyed: {refused}", flush=True)
        async for text in telemetry.subscribe_status_text():
            print(text.text, flush=True)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1])))
