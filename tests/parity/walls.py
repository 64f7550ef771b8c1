"""How far from a wall do both autopilots stop, under a velocity towards it in GUIDED? Each aircraft flies alone."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.verdicts import Inject, Verdict
from skyrange.core.geodesy import Origin
from skyrange.core.ids import endpoint
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.parity.flights import DEADLINE_S
from skyrange.record import RunRecord
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.runs import run
from tools.agreement.gnss_reactions import HOLD

WALL_M = 40.0
"""The wall is so far east of where each aircraft takes off, and upright."""
LANE_M = 150.0
"""From one aircraft to the next, beyond the range of the LiDAR."""
MARGIN_M = 3.0
PUSH_S, UNTIL_S = 30.0, 60.0
"""From when to when velocities are sent: all hover by then, and the slowest has stopped for five seconds."""
PERIOD_NS: Time = 100 * NS_PER_MS
"""Less than the 200 ms after which ArduCopter forgets to which velocity it has limited the last one."""
ORIGIN = {"lat": -35.363328, "lon": 149.1652241, "alt_msl_m": 10.0}


class Approach(NamedTuple):
    """One aircraft: velocity east and north, AVOID_BEHAVE, heading, and whether a gimbal keeps the LiDAR level."""

    east_mps: float
    north_mps: float = 0.0
    behave: int = 0
    heading_deg: float = 90.0
    level: bool = True


APPROACHES: Mapping[str, Approach] = {
    "slide-2": Approach(2.0),
    "slide-5": Approach(5.0),
    "slide-8": Approach(8.0),
    "stop-2": Approach(2.0, behave=1),
    "stop-5": Approach(5.0, behave=1),
    "turned-5": Approach(5.0, heading_deg=60.0),
    "fixed-5": Approach(5.0, level=False),
    "oblique-5": Approach(4.0, 3.0),
}
NEAREST_M = 1.0
"""Nearer than this it would be close to the wall with its propellers."""


@dataclass
class Push:
    """A companion program that commands GUIDED once, then a velocity ten times a second."""

    approach: Approach
    vehicle: str
    system: int

    def __post_init__(self) -> None:
        self.packer = Packer(self.system, 191)
        self.due: Time = int(PUSH_S * NS_PER_S)

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return []

    def next_wakeup(self) -> Time | None:
        return self.due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        messages: list[Any] = []
        if now < PUSH_S * NS_PER_S + PERIOD_NS:
            flags = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            command = mav.MAV_CMD_DO_SET_MODE
            messages.append(
                mav.MAVLink_command_long_message(self.system, 1, command, 0, flags, mav.COPTER_MODE_GUIDED, *[0] * 5)
            )
        east, north = self.approach.east_mps, self.approach.north_mps
        messages.append(
            mav.MAVLink_set_position_target_local_ned_message(
                now // NS_PER_MS,
                self.system,
                1,
                mav.MAV_FRAME_LOCAL_NED,
                0b110111000111,
                0,
                0,
                0,
                north,
                east,
                *[0] * 6,
            )
        )
        self.due = now + PERIOD_NS
        ends = endpoint(self.vehicle, "companion"), endpoint(self.vehicle, "proxy")
        return [Inject(self.packer.pack(message), "fwd", *ends) for message in messages]


def scenario(folder: Path, autopilot: str, names: Sequence[str] = tuple(APPROACHES)) -> Scenario:
    """The aircraft of `names`, which take off to 10 m and hover until they are pushed. Files are put into `folder`."""
    (folder / "hold.waypoints").write_text(HOLD.format(alt=10.0, hold=UNTIL_S))
    half_m = LANE_M * (len(names) + 1)
    corners = [(WALL_M, -half_m), (WALL_M + 5.0, -half_m), (WALL_M + 5.0, half_m), (WALL_M, half_m), (WALL_M, -half_m)]
    places = [Origin(*ORIGIN.values()).geodetic_of(*corner) for corner in corners]
    shape = {"type": "Polygon", "coordinates": [[[lon, lat] for lat, lon in places]]}
    wall = {"type": "Feature", "properties": {"height": 30}, "geometry": shape}
    (folder / "wall.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [wall]}))
    return Scenario.model_validate(
        {
            "name": "walls",
            "duration_s": UNTIL_S,
            "origin": ORIGIN,
            "city": {"buildings": str(folder / "wall.geojson")},
            "sensors": {"noise": 0.0},
            "autopilots": {"deadline_s": DEADLINE_S},
            "operators": [
                {"id": "blue", "vehicles": [_vehicle(folder, autopilot, k, name) for k, name in enumerate(names)]}
            ],
        }
    )


def _vehicle(folder: Path, autopilot: str, place: int, name: str) -> dict[str, Any]:
    approach = APPROACHES[name]
    lidar = {"model": "vlp-16", "azimuths": 360, "stabilised": approach.level, "to_autopilot": "obstacles"}
    return {
        "id": name,
        "autopilot": autopilot,
        "start": [0.0, LANE_M * place, approach.heading_deg],
        "plan": {"file": str(folder / "hold.waypoints"), "anchor": "start"},
        "sensors": [lidar],
        "params": {"PRX1_TYPE": 2, "AVOID_ENABLE": 2, "AVOID_MARGIN": MARGIN_M, "AVOID_BEHAVE": approach.behave},
    }


def flown(folder: Path, autopilot: str, names: Sequence[str] = tuple(APPROACHES)) -> RunRecord:
    """The approaches under one autopilot; the run is in `folder` under its name."""
    folder.mkdir(parents=True, exist_ok=True)
    made = scenario(folder, autopilot, names)
    taps = [
        TapPlacement(f"log:blue/{v.id}", "companion", _Make(APPROACHES[v.id], f"blue/{v.id}", v.system_id))
        for v in made.operators[0].vehicles
    ]
    return run(made, folder / autopilot, taps=taps)


@dataclass
class _Make:
    approach: Approach
    vehicle: str
    system: int

    def __call__(self, link: str) -> Push:
        return Push(self.approach, self.vehicle, self.system)


class Stop(NamedTuple):
    """Distances of an aircraft's middle from the wall in metres, and speeds in m/s."""

    nearest_m: float
    final_m: float
    """Mean of the last five seconds."""
    fastest_mps: float
    slid_mps: float
    """Mean speed along the wall in the last five seconds."""


def measure(record: RunRecord) -> Mapping[str, Stop]:
    """The stops of a run by aircraft."""
    columns = ["time_ns", "vehicle", "east_m", "vel_east_mps", "vel_north_mps"]
    truth = record.table("truth", columns).to_pandas()
    stops = {}
    for vehicle, rows in truth[truth["time_ns"] >= PUSH_S * NS_PER_S].groupby("vehicle"):
        last = rows[rows["time_ns"] >= (UNTIL_S - 5.0) * NS_PER_S]
        fastest = float(np.hypot(rows["vel_east_mps"], rows["vel_north_mps"]).max())
        stops[str(vehicle).split("/")[1]] = Stop(
            WALL_M - float(rows["east_m"].max()),
            WALL_M - float(last["east_m"].mean()),
            fastest,
            float(last["vel_north_mps"].mean()),
        )
    return stops


def main(folder: Path, autopilots: Sequence[str]) -> None:
    """Print the stops."""
    for autopilot in autopilots:
        for name, stop in measure(flown(folder, autopilot)).items():
            print(autopilot, name, *(f"{value:.2f}" for value in stop))


if __name__ == "__main__":
    import sys

    main(Path(sys.argv[1]), sys.argv[2:] or ["builtin", "ardupilot"])
