"""Benchmark of fleets in virtual time: complete missions over three hops, everything recorded."""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skyrange.assembly.build import Additions
from skyrange.bench.isolation import run_in_process
from skyrange.bench.sampling import PARTS, Sampler
from skyrange.bench.yardstick import yardstick_us
from skyrange.contracts.monitors import MonitorPlacement
from skyrange.core.time import to_seconds
from skyrange.detect.heartbeat.gap import HeartbeatGap
from skyrange.record import load
from skyrange.runtime.memory import peak_memory_mb
from skyrange.runtime.run import Run
from skyrange.scenario.model.fleet import Autopilots
from skyrange.scenario.model.scenario import (
    Avoidance,
    City,
    Grid,
    Operator,
    Origin,
    Radio,
    Scenario,
    Start,
    Vehicle,
    path,
)

__all__ = ["LIGHT", "PARTS", "WARM_UP_S", "FleetOptions", "fleet_scenario", "flying", "measure"]

WARM_UP_S = 30.0
"""Simulated seconds before measuring: plans are approved, uploaded, read back, and all are flying by then."""
SPEED_MPS = 5.0
SIDE_M = 80.0
APART_M = 40.0
PER_OPERATOR = 1000
WALL_M = 10.0
"""Distance between a lap and the block that it goes round, with Remote ID."""
_DETECTOR = MonitorPlacement("gap", HeartbeatGap, ["gcs:*"], "gcs")
HORIZON_M = 400.0
"""Horizon of the radio medium, the best range that opendroneid.org gives for Wi-Fi; some thirty aircraft are nearer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetOptions:
    """How a fleet flies, besides its size and time.

    `load` is the telemetry that ground stations request, a profile of `gcs.streams`. With `remote_id` each aircraft
    goes round a block of a downtown, broadcasts over Wi-Fi every second, receives the others and would avoid them.
    `options` are those of the autopilot's kind. The aircraft belong to `operators` operators in equal parts; 0 is one
    for each thousand.
    """

    load: str = "light"
    remote_id: bool = False
    autopilot: str = "builtin"
    options: Mapping[str, Any] = field(default_factory=dict)
    operators: int = 0


LIGHT = FleetOptions()


def fleet_scenario(vehicles: int, seconds: float, fleet: FleetOptions = LIGHT) -> Scenario:
    """`vehicles` aircraft on a lattice, each flying laps of a square at 5 m/s for `seconds` after the warm-up."""
    # a third more than the time requires, because corners are cut
    path_m = 1.33 * SPEED_MPS * (WARM_UP_S + seconds)
    # at most ten laps, so that a long flight has no longer upload than a short one
    laps = min(10, math.ceil(path_m / (4 * SIDE_M)))
    side_m = max(SIDE_M, path_m / (4 * laps))
    lap = [(0.0, side_m), (side_m, side_m), (side_m, 0.0), (0.0, 0.0)]
    points = [(0.0, 0.0), *(lap * laps)]
    columns = math.ceil(math.sqrt(vehicles))
    spacing_m = side_m + APART_M
    first_m = -0.5 * (columns - 1) * spacing_m - 0.5 * side_m  # so that laps go round the blocks of a downtown
    aircraft = [
        Vehicle(
            start=Start(
                east_m=first_m + spacing_m * (index % columns), north_m=first_m + spacing_m * (index // columns)
            ),
            plan=path(points, alt_m=30.0, speed_mps=SPEED_MPS),
            autopilot=fleet.autopilot,
        )
        for index in range(vehicles)
    ]
    per_operator = PER_OPERATOR if fleet.operators == 0 else math.ceil(vehicles / fleet.operators)
    owners = [
        Operator(
            id=f"op{start // per_operator + 1}",
            streams=fleet.load,
            avoidance=Avoidance(kind="geometric") if fleet.remote_id else None,
            vehicles=tuple(aircraft[start : start + per_operator]),
        )
        for start in range(0, vehicles, per_operator)
    ]
    return Scenario(
        name=f"bench fleet {vehicles}",
        duration_s=WARM_UP_S + seconds,
        origin=Origin(lat=-35.3633280, lon=149.1652241),
        operators=tuple(owners),
        city=_downtown(columns, side_m) if fleet.remote_id else None,
        radio=Radio(horizon_m=HORIZON_M, city_busy=0.2) if fleet.remote_id else None,
        autopilots=Autopilots().with_options(fleet.autopilot, fleet.options, "bench"),
    )


def _downtown(columns: int, side_m: float) -> City:
    """A block inside each lap, of four buildings 20 to 90 m high."""
    block_m = side_m - 2 * WALL_M
    return City(grid=Grid(blocks=(columns, columns), street_m=side_m + APART_M - block_m, block_m=block_m))


def measure(vehicles: int, seconds: float, fleet: FleetOptions = LIGHT, *, detector: bool = False) -> dict[str, Any]:
    """One row: fly `vehicles` for `seconds` simulated seconds in a process of its own.

    With `detector` a heartbeat gap detector listens at the ground stations' ends of all `gcs` links.

    `total_factor` is simulated seconds, the warm-up included, over `total_s`, the wall seconds from the start of the
    process to its end; it has one CPU. `real_time_factor` is that of the measured flight, recording on; `cpu_s` is the
    process's CPU time for that (user and system); `yardstick_us` the result of `yardstick` at the end, and
    `yardsticks` the cost of an aircraft-second in that unit; `memory_mb` the peak resident set size, of which
    `base_memory_mb` was used before the fleet; `setup_s` and `finalise_s` are wall seconds before and after the
    measured flight; `flying` is the number of aircraft armed and on their mission throughout; `frames_per_s` frames per
    simulated second over all hops, `receptions_per_s` decoded broadcasts; `disk_mb` the size of the finished run
    folder, `bytes_per_frame` that for each frame on each hop; `share` the share of CPU time per part.
    """
    began = time.perf_counter()
    name = f"bench with {vehicles} aircraft"
    row = run_in_process(name, _flown, vehicles, seconds, fleet, detector=detector)
    total_s = time.perf_counter() - began - row.pop("evaluation_s")
    return {**row, "total_s": round(total_s, 3), "total_factor": round((WARM_UP_S + seconds) / total_s, 3)}


def _flown(vehicles: int, seconds: float, fleet: FleetOptions, *, detector: bool) -> dict[str, Any]:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    base_mb = peak_memory_mb()
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        scenario = fleet_scenario(vehicles, seconds, fleet)
        run = Run.start(scenario, Path(folder) / "run", additions=Additions(monitors=[_DETECTOR] if detector else ()))
        run.advance(WARM_UP_S)
        setup_s = time.perf_counter() - began
        with Sampler() as sampler:
            cpu = time.process_time()
            wall = time.perf_counter()
            run.advance(WARM_UP_S + seconds)
            wall_s = time.perf_counter() - wall
            cpu_s = time.process_time() - cpu
        began = time.perf_counter()
        run.finish()
        finalise_s = time.perf_counter() - began
        began = time.perf_counter()
        yard_us = yardstick_us()
        record = load(Path(folder) / "run")
        disk_bytes = sum(f.stat().st_size for f in record.path.rglob("*") if f.is_file())
        row = {
            "vehicles": vehicles,
            "seconds": seconds,
            "load": fleet.load,
            "remote_id": fleet.remote_id,
            "detector": detector,
            "real_time_factor": round(seconds / wall_s, 3),
            "cpu_s": round(cpu_s, 3),
            "yardstick_us": round(yard_us, 2),
            "yardsticks": round(cpu_s / seconds / vehicles * 1e6 / yard_us, 1),
            "memory_mb": round(peak_memory_mb(), 1),
            "base_memory_mb": round(base_mb, 1),
            "wall_s": round(wall_s, 3),
            "setup_s": round(setup_s, 3),
            "finalise_s": round(finalise_s, 3),
            "flying": flying(record),
            "receptions_per_s": round(record.rows("receptions") / to_seconds(run.now), 1),
            "frames_per_s": round(record.rows("frames") / to_seconds(run.now), 1),
            "disk_mb": round(disk_bytes / 1e6, 2),
            "bytes_per_frame": round(disk_bytes / max(record.rows("frames"), 1), 1),
            "share": sampler.shares(),
        }
        return {**row, "evaluation_s": time.perf_counter() - began}


def flying(record: Any) -> int:
    """Aircraft that were off the ground from the end of the warm-up to the end."""
    import pyarrow.compute as pc

    low: set[str] = set()
    for batch in record.batches("truth", ["time_ns", "vehicle", "up_m"]):
        late = batch.filter(pc.and_(pc.greater(batch.column(0), int(WARM_UP_S * 1e9)), pc.less(batch.column(2), 1.0)))
        low.update(late.column(1).to_pylist())
    return len(record.manifest["vehicles"]) - len(low)
