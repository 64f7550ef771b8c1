"""How many ArduPilots fly how fast? Armed, on a mission, all recorded; and what the bare processes would take."""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from skyrange.bench.fleet import WARM_UP_S, fleet_scenario, flying
from skyrange.core.errors import ComponentError
from skyrange.core.time import to_seconds
from skyrange.io.sitl import LockstepSitl, wall_s
from skyrange.record import load as load_record
from skyrange.runtime.run import Run
from skyrange.vehicle.ardupilot.binary import find
from skyrange.vehicle.ardupilot.inventory import parameters_of
from skyrange.vehicle.ardupilot.packets import Motion, lines, stamp_s
from skyrange.vehicle.ardupilot.parameters import LOOP_RATE, SIM_RATE, start_values, steps_of, text_of
from skyrange.world.airframes import AIRFRAMES

RATES: Mapping[str, Mapping[str, float]] = {"full": {}, "reduced": {LOOP_RATE: 100.0, SIM_RATE: 200.0}}
"""ArduCopter's own loop at 400 Hz, or a stated trade."""
QUANTUM_S = 0.0025
BARE_S = 10.0
"""Simulated seconds for which the bare processes run, after as many to boot."""


def measure(vehicles: int, seconds: float, load: str = "light", rates: str = "full") -> dict[str, Any]:
    """One row: fly `vehicles` for `seconds` simulated seconds in a process of its own, as fast as it goes.

    `real_time_factor` is simulated over wall seconds while flying, recording on; `autopilots_cpu_s` and `ours_cpu_s`
    the processor time of all ArduPilot processes and of everything else for that; `per_core` how many aircraft one
    core would carry in real time, by processor time. `bare_cpu_s` is what as many processes take for as many seconds
    with nothing around them, standing still and fed by the least loop there is, measured right before; `over_bare`
    the whole over that. `loop_hz` and `exchanges_hz` are what ran; `flying` as in `bench fleet`.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_worker, args=(sender, vehicles, seconds, load, rates))
    process.start()
    sender.close()
    try:
        row: dict[str, Any] = receiver.recv()
    except EOFError:
        process.join()
        raise ComponentError(f"bench with {vehicles} ArduPilots", f"ended with exit code {process.exitcode}") from None
    process.join()
    return row


def _worker(answer: Connection, vehicles: int, seconds: float, load: str, rates: str) -> None:
    binary = find()
    listed = parameters_of(binary.path, binary.sha256)
    values = start_values("bench", AIRFRAMES["iris"], RATES[rates], listed, 120)
    per_tick, ticks = steps_of(values, listed, QUANTUM_S)
    bare_s = _bare(vehicles, text_of(values), QUANTUM_S * ticks / per_tick) * seconds / BARE_S
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        scenario = fleet_scenario(vehicles, seconds, load, autopilot="ardupilot", params=RATES[rates])
        run = Run.start(scenario, Path(folder) / "run")
        engine: Any = next(mount.engine for mount in run.rig.wiring.engines)
        run.advance(WARM_UP_S)
        setup_s = time.perf_counter() - began
        theirs, ours, wall = engine.cpu_s, time.process_time(), time.perf_counter()
        run.advance(WARM_UP_S + seconds)
        took_s = time.perf_counter() - wall
        theirs, ours = engine.cpu_s - theirs, time.process_time() - ours
        run.finish()
        record = load_record(Path(folder) / "run")
        row = {
            "vehicles": vehicles,
            "seconds": seconds,
            "load": load,
            "loop_hz": values.get(LOOP_RATE, listed.get(LOOP_RATE)),
            "exchanges_hz": round(per_tick / ticks / QUANTUM_S, 1),
            "real_time_factor": round(seconds / took_s, 3),
            "autopilots_cpu_s": round(theirs, 2),
            "ours_cpu_s": round(ours, 2),
            "bare_cpu_s": round(bare_s, 2),
            "over_bare": round((theirs + ours) / bare_s, 2),
            "per_core": round(vehicles * seconds / (theirs + ours), 1),
            "setup_s": round(setup_s, 2),
            "flying": flying(record),
            "frames_per_s": round(record.rows("frames") / to_seconds(run.now), 1),
        }
    answer.send(row)
    answer.close()


def _bare(vehicles: int, parameters: str, step_s: float) -> float:
    """Processor seconds that so many processes take for `BARE_S`, all stepped side by side."""
    standing = Motion(np.zeros((1, 3)), np.array([[0.0, 0.0, -9.80665]]), np.zeros(1), np.eye(1, 4), np.zeros(1))
    step_ns = round(step_s * 1e9)
    steps = round(BARE_S / step_s)
    with tempfile.TemporaryDirectory() as folder:
        fleet = []
        for number in range(vehicles):
            own = Path(folder) / str(number)
            own.mkdir()
            fleet.append(
                LockstepSitl(
                    f"arducopter {number + 1}", find().path, own, home=(0.0, 1.0, 0.0, 0.0), system_id=1,
                    start_unix_s=1, parameters=parameters,
                )
            )  # fmt: skip
        try:
            before = 0.0
            for step in range(1, 2 * steps + 1):
                if step == steps + 1:
                    before = sum(sitl.program.cpu_s for sitl in fleet)
                (line,) = lines([stamp_s(step, step_ns)], standing)
                for sitl in fleet:
                    if sitl.servos(wall_s() + 30.0) is None:
                        raise sitl.lost("did not answer")
                    sitl.send(line)
                    if not sitl.connected:
                        sitl.accept()
                    elif step % 64 == 0:
                        sitl.read(0), sitl.read(1)
            return sum(sitl.program.cpu_s for sitl in fleet) - before
        finally:
            for sitl in fleet:
                sitl.close()
