"""Benchmark of one run on several cores: the same fleet on one core and on more, each pinned to CPUs of its own."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from skyrange.bench.fleet import LIGHT, WARM_UP_S, FleetOptions, fleet_scenario, flying
from skyrange.bench.isolation import run_in_process
from skyrange.core.errors import InputError
from skyrange.core.time import Time, to_seconds
from skyrange.record import load as load_record
from skyrange.runtime.cores.division import available_cpus, divide
from skyrange.runtime.cores.run import run_on_cores
from skyrange.runtime.run import Run

Row = dict[str, Any]


def check_cores(numbers: Sequence[int]) -> None:
    """Raise `InputError` for more cores than CPUs that this process may use."""
    cpus = len(available_cpus())
    if max(numbers) > cpus:
        expected = f"at most {cpus}, the CPUs that this process may use"
        raise InputError.one("bench", "--cores", str(max(numbers)), expected)


def measure(vehicles: int, seconds: float, cores: int, fleet: FleetOptions = LIGHT, *, turn: int = 0) -> Row:
    """One row: a fleet of `bench.fleet`, flown on `cores` cores in a process of its own.

    The processes are pinned to `cores` of the CPUs that this process may use, one each; with one core everything,
    ArduPilots included, has one CPU. The CPUs are counted from number `turn` on: with a turn for each repetition, the
    run on one core has each of them once, because their speeds may differ.

    `total_factor` and `total_s` are those of `bench.fleet.measure`; `real_time_factor` is that of the flight after the
    warm-up, `setup_s` and `finish_s` are wall seconds before and after it; `waited_s` has for each core how long it
    waited for others, `cpu_s` its processor time without ArduPilots, `memory_mb` its peak memory; `reason` says why
    fewer cores were `used`. Raises `InputError` for more cores than CPUs.
    """
    cpus = available_cpus()
    check_cores([cores])
    cpus = [cpus[(turn + number) % len(cpus)] for number in range(cores)]
    began = time.perf_counter()
    row = run_in_process(f"bench on {cores} cores", _flown, vehicles, seconds, fleet, cpus)
    total_s = time.perf_counter() - began - row.pop("evaluation_s")
    return {**row, "total_s": round(total_s, 3), "total_factor": round((WARM_UP_S + seconds) / total_s, 3)}


def _flown(vehicles: int, seconds: float, fleet: FleetOptions, cpus: list[int]) -> Row:
    cores = len(cpus)
    scenario = fleet_scenario(vehicles, seconds, fleet)
    division = divide(scenario, cores)  # before this process is pinned, because it asks for the CPUs
    os.sched_setaffinity(0, cpus[:1])
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        began = time.perf_counter()
        marks: list[float] = []

        def note_time(now: Time, end: Time) -> None:
            if (not marks and to_seconds(now) >= WARM_UP_S) or now >= end:
                marks.append(time.perf_counter())

        if division.cores > 1:
            run_on_cores(scenario, division, cores, folder, on_progress=note_time, cpus=cpus)
        else:
            Run.start(scenario, folder).execute(on_progress=note_time)
        finish_s = time.perf_counter() - marks[-1]
        evaluated = time.perf_counter()
        record = load_record(folder)
        timings = record.manifest["timings"]
        parts = (record.manifest.get("cores") or {}).get("parts") or []
        row = {
            "vehicles": vehicles,
            "seconds": seconds,
            "operators": fleet.operators,
            "load": fleet.load,
            "remote_id": fleet.remote_id,
            "autopilot": fleet.autopilot,
            "cores": cores,
            "used": division.cores,
            "reason": division.reason,
            "setup_s": round(marks[0] - began, 3),
            "wall_s": round(marks[-1] - marks[0], 3),
            "real_time_factor": round(seconds / (marks[-1] - marks[0]), 3),
            "finish_s": round(finish_s, 3),
            "waited_s": [part["waited_s"] for part in parts],
            "cpu_s": [part["cpu_s"] for part in parts] or [round(time.process_time(), 3)],
            "memory_mb": [part["peak_memory_mb"] for part in parts] or [timings["peak_memory_mb"]],
            "flying": flying(record),
            "frames": record.rows("frames"),
            "fingerprint": record.manifest["digests"]["fingerprint"],
        }
        return {**row, "evaluation_s": time.perf_counter() - evaluated}


def compare(rows: list[Row]) -> list[Row]:
    """The medians of the rows with equal numbers of cores; `speed_up` and `flight_speed_up` say how many times as fast
    as on one core all of it and the flight were, `None` without rows on one core.
    """
    medians = []
    times = {}
    for cores in sorted({row["cores"] for row in rows}):
        same = [row for row in rows if row["cores"] == cores]
        times[cores] = median(row["total_s"] for row in same), median(row["wall_s"] for row in same)
        alone = times.get(1)
        medians.append(
            {
                "cores": cores,
                "runs": len(same),
                "total_s": times[cores][0],
                "wall_s": times[cores][1],
                "speed_up": None if alone is None else round(alone[0] / times[cores][0], 3),
                "flight_speed_up": None if alone is None else round(alone[1] / times[cores][1], 3),
                "same_fingerprint": len({row["fingerprint"] for row in rows}) == 1,
            }
        )
    return medians
