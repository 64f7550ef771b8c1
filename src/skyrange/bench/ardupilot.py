"""Benchmark of ArduPilot fleets: armed, on a mission, all recorded; and the cost of the bare processes."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from skyrange.bench.fleet import WARM_UP_S, FleetOptions, fleet_scenario, flying
from skyrange.bench.isolation import run_in_process
from skyrange.core.time import to_seconds
from skyrange.io.ardupilot.sitl import LockstepSitl, Sitl, wall_s
from skyrange.record import load as load_record
from skyrange.runtime.run import Run
from skyrange.vehicle.ardupilot.arducopter_binary import find_binary
from skyrange.vehicle.ardupilot.json_backend.json_lines import format_lines
from skyrange.vehicle.ardupilot.json_backend.motion import STANDING, step_time_s
from skyrange.vehicle.ardupilot.native_fleet import MODEL, SPEEDUP
from skyrange.vehicle.ardupilot.parameters import (
    LOOP_RATE,
    defaults_text,
    exchange_steps,
    list_parameters,
    moments_per_iteration,
    start_values,
)
from skyrange.world.airframes import AIRFRAMES

QUANTUM_S = 0.0025
BARE_S = 10.0
"""Simulated seconds for which the bare processes run, after as many to boot."""


def measure(
    vehicles: int,
    seconds: float,
    *,
    load: str = "light",
    rates: str = "full",
    physics: str = "shared",
    speedup: float = 1.0,
    remote_id: bool = False,
) -> dict[str, Any]:
    """One row: fly `vehicles` for `seconds` simulated seconds in a process of its own.

    With `physics` "shared" as fast as possible, with "native" at `speedup`; `remote_id` as in `bench.fleet`.
    `real_time_factor` is simulated over wall seconds while flying, recording on; `autopilots_cpu_s` and `ours_cpu_s`
    are the processor time of all ArduPilot processes and of everything else for that; `per_core` is the number of
    aircraft that one core would carry in real time, by processor time. `bare_cpu_s` is the processor time of as many
    processes for as many seconds with nothing around them, standing still, measured right before: fed by a minimal
    loop, or left alone with their own physics; `over_bare` is the whole divided by that, `ours_over_bare` our part.
    `loop_hz` and `exchanges_hz` (0: none) are the rates that ran; `flying` is as in `bench fleet`. Raises `InputError`
    for rates that native physics does not have.
    """
    native = physics == "native"
    options = {"rates": rates, **({"physics": "native", "speedup": speedup} if native else {})}
    fleet = FleetOptions(load=load, remote_id=remote_id, autopilot="ardupilot", options=options)
    return run_in_process(f"bench with {vehicles} ArduPilots", _flown, vehicles, seconds, fleet)


def _flown(vehicles: int, seconds: float, fleet: FleetOptions) -> dict[str, Any]:
    rates, speedup = fleet.options["rates"], fleet.options.get("speedup")  # a speed only of native physics
    scenario = fleet_scenario(vehicles, seconds, fleet)
    binary = find_binary()
    listed = list_parameters(binary.path, binary.sha256)
    values = start_values("bench", AIRFRAMES["iris"], {}, listed, 120, rates)
    per_tick, ticks = exchange_steps(values, listed, QUANTUM_S)
    text = defaults_text(values)
    if speedup is not None:
        bare_s = _alone(vehicles, text, speedup)
    else:
        bare_s = _bare(vehicles, text, per_tick / ticks, per_tick * moments_per_iteration(values, listed, QUANTUM_S))
    bare_s *= seconds / BARE_S
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        run = Run.start(scenario, Path(folder) / "run")
        engine: Any = next(mount.engine for mount in run.built.wiring.engines)
        run.advance(WARM_UP_S)
        setup_s = time.perf_counter() - began
        engine_cpu_s, own_cpu_s, wall = engine.cpu_s, time.process_time(), time.perf_counter()
        run.advance(WARM_UP_S + seconds)
        took_s = time.perf_counter() - wall
        engine_cpu_s, own_cpu_s = engine.cpu_s - engine_cpu_s, time.process_time() - own_cpu_s
        run.finish()
        record = load_record(Path(folder) / "run")
        return {
            "vehicles": vehicles,
            "seconds": seconds,
            "load": fleet.load,
            "remote_id": fleet.remote_id,
            "physics": fleet.options.get("physics", "shared"),
            "speedup": speedup,
            "loop_hz": values.get(LOOP_RATE, listed.get(LOOP_RATE)),
            "exchanges_hz": 0.0 if speedup is not None else round(per_tick / ticks / QUANTUM_S, 1),
            "real_time_factor": round(seconds / took_s, 3),
            "autopilots_cpu_s": round(engine_cpu_s, 2),
            "ours_cpu_s": round(own_cpu_s, 2),
            "bare_cpu_s": round(bare_s, 2),
            "over_bare": round((engine_cpu_s + own_cpu_s) / bare_s, 2),
            "ours_over_bare": round(own_cpu_s / bare_s, 2),
            "per_core": round(vehicles * seconds / (engine_cpu_s + own_cpu_s), 1),
            "setup_s": round(setup_s, 2),
            "flying": flying(record),
            "frames_per_s": round(record.rows("frames") / to_seconds(run.now), 1),
        }


def _bare(vehicles: int, parameters: str, rate: float, batch: int) -> float:
    """Processor seconds that so many processes use for `BARE_S` simulated seconds, in parallel.

    `rate` is exchanges per tick, `batch` the number sent together, as in the range.
    """
    step_ns = round(QUANTUM_S / rate * 1e9)
    steps = round(BARE_S * 1e9 / step_ns)
    fleet: list[LockstepSitl] = []
    with _closing(fleet), tempfile.TemporaryDirectory() as folder:
        fleet += [LockstepSitl(**arguments) for arguments in _processes(vehicles, Path(folder), parameters)]
        before = 0.0
        for sitl in fleet:
            _answered(sitl)
        for step in range(0, 2 * steps, batch):
            if step == steps:
                before = sum(sitl.program.cpu_s for sitl in fleet)
            rows = [
                line
                for turn in range(batch)
                for line in format_lines([step_time_s(step + turn + 1, step_ns)], STANDING)
            ]
            for sitl in fleet:
                for line in rows:
                    sitl.send(line)
            for sitl in fleet:
                for _ in rows:
                    _answered(sitl)
                if not sitl.connected:
                    sitl.accept()
                elif step % 64 == 0:
                    sitl.read(0), sitl.read(1)
        return sum(sitl.program.cpu_s for sitl in fleet) - before


def _alone(vehicles: int, parameters: str, speedup: float) -> float:
    """Processor seconds of so many processes on the ground for `BARE_S` of their own time, with their own physics."""
    fleet: list[Sitl] = []
    text = f"{parameters}{SPEEDUP} {speedup:g}\n"
    with _closing(fleet), tempfile.TemporaryDirectory() as folder:
        fleet += [Sitl(model=MODEL, **arguments) for arguments in _processes(vehicles, Path(folder), text)]
        before = 0.0
        for half in (1, 2):
            until = wall_s() + BARE_S / speedup
            before = sum(sitl.program.cpu_s for sitl in fleet) if half == 2 else 0.0
            while wall_s() < until:
                for sitl in fleet:
                    sitl.accept(), sitl.read(0), sitl.read(1)
                time.sleep(0.05)
        return sum(sitl.program.cpu_s for sitl in fleet) - before


def _processes(vehicles: int, folder: Path, parameters: str) -> Iterator[dict[str, Any]]:
    """The arguments with which each process is started."""
    for number in range(vehicles):
        process_folder = folder / str(number)
        process_folder.mkdir()
        yield {
            "name": f"arducopter {number + 1}",
            "binary": find_binary().path,
            "folder": process_folder,
            "home": (0.0, 1.0, 0.0, 0.0),
            "system_id": 1,
            "start_unix_s": 1,
            "parameters": parameters,
        }


@contextmanager
def _closing(fleet: Sequence[Sitl]) -> Iterator[None]:
    try:
        yield
    finally:
        for sitl in fleet:
            sitl.close()


def _answered(sitl: LockstepSitl) -> None:
    if sitl.servos(wall_s() + 30.0) is None:
        raise sitl.lost("did not answer")
