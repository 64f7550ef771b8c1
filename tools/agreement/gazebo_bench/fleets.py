"""Benchmark of ArduPilots in Gazebo: real-time factor against their number, beside the range's own physics."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Final

from skyrange.bench.fleet import WARM_UP_S, FleetOptions, fleet_scenario, flying
from skyrange.bench.isolation import run_in_process
from skyrange.bench.suite.machine import describe_machine
from skyrange.record import load as load_record
from skyrange.runtime.run import Run
from skyrange.vehicle.gazebo.gazebo_program import Flavour, Gazebo, find_gazebo, find_window
from skyrange.vehicle.gazebo.plugin_library import find_plugin

Row = dict[str, Any]

PHYSICS: Final = {"gazebo": "gazebo", "range": "ardupilot"}
"""Both kinds of physics, with the autopilot that has them."""
TOO_SLOW: Final = 0.4
"""A fleet that runs at less than this real-time factor in Gazebo is the last one."""
PUBLISHED_VEHICLES: Final = 5
"""About how many aircraft the published system runs in real time with Gazebo."""
PUBLISHED: Final = "on 24 cores and two graphics processors, with 3D rendering"
"""What it ran on."""


def require_gazebo(*, window: bool = False) -> None:
    """Raise `InputError` if Gazebo, skyrange's plugin for it or, with `window`, its window is missing."""
    gazebo = find_gazebo()
    find_plugin(gazebo)
    if window:
        find_window(gazebo)


def measure(
    vehicles: int, seconds: float, *, windows: int = 3, load: str = "light", rates: str = "full", window: bool = False
) -> Row:
    """One row: fly `vehicles` in Gazebo and in the range's own physics, both in one process of its own, as fast as
    possible, each measured for `seconds` simulated seconds, `windows` times.

    Both fleets are started and warmed up first, and then measured in turn, so that a busy machine slows both; one is at
    rest while the other is measured. With `window` Gazebo's window is open, which uses processors at rest too: then
    the range's windows come first. For both physics: `real_time_factor` is the median of simulated over wall seconds,
    recording on, `inverse` its inverse, and `factors` all of them; `autopilots_cpu_s`, `gazebo_cpu_s`, `window_cpu_s`
    and `ours_cpu_s` are the processor seconds for one simulated second, of all ArduPilots, of Gazebo, of its window and
    of everything else; `flying` is as in `bench fleet`. `slower` is the real-time factor of the range over that of
    Gazebo. Raises `InputError` without Gazebo or ArduCopter.
    """
    name = f"bench with {vehicles} aircraft in Gazebo"
    return run_in_process(name, _flown, vehicles, seconds, windows=windows, load=load, rates=rates, window=window)


@dataclass(slots=True)
class _Flight:
    """A fleet under way, and what was measured of it."""

    run: Run
    engine: Any
    until_s: float
    rows: list[Row]

    def advance(self, seconds: float) -> None:
        """Measure the next `seconds` simulated seconds."""
        before, ours, wall = _processor_times_s(self.engine), time.process_time(), time.perf_counter()
        self.until_s += seconds
        self.run.advance(self.until_s)
        took_s, ours = time.perf_counter() - wall, time.process_time() - ours
        after = _processor_times_s(self.engine)
        self.rows.append(
            {
                "real_time_factor": seconds / took_s,
                "ours_cpu_s": ours / seconds,
                **{name: (after[name] - before[name]) / seconds for name in after},
            }
        )


def _processor_times_s(engine: Any) -> dict[str, float]:
    gazebo_s = getattr(engine, "simulator_cpu_s", 0.0)
    window_s = getattr(engine, "window_cpu_s", 0.0)
    return {"gazebo_cpu_s": gazebo_s, "autopilots_cpu_s": engine.cpu_s - gazebo_s, "window_cpu_s": window_s}


def _flown(vehicles: int, seconds: float, *, windows: int, load: str, rates: str, window: bool) -> Row:
    row: Row = {"vehicles": vehicles, "seconds": seconds, "windows": windows, "window": window, "load": load}
    for group in (("range",), ("gazebo",)) if window else (("gazebo", "range"),):
        with tempfile.TemporaryDirectory() as folder, ExitStack() as ending:
            flights = {}
            for physics in group:
                options = {"rates": rates, **({"window": True} if window and physics == "gazebo" else {})}
                fleet = FleetOptions(load=load, autopilot=PHYSICS[physics], options=options)
                scenario = fleet_scenario(vehicles, seconds * windows, fleet)
                run = Run.start(scenario, Path(folder) / physics)
                ending.callback(run.finish)  # ends its programs if an error interrupts it
                (mount,) = run.built.wiring.engines
                flights[physics] = _Flight(run, mount.engine, WARM_UP_S, [])
                run.advance(WARM_UP_S)
            for _ in range(windows):
                for flight in flights.values():
                    flight.advance(seconds)
            for physics, flight in flights.items():
                flight.run.finish()
                record = load_record(Path(folder) / physics)
                row[physics] = summarise(flight.rows) | {"flying": flying(record)}
                if physics == "gazebo":
                    row["versions"] = versions(record.manifest)
    row["slower"] = round(row["range"]["real_time_factor"] / row["gazebo"]["real_time_factor"], 3)
    return row


def versions(manifest: Mapping[str, Any]) -> dict[str, str]:
    """The programs of a run in Gazebo: Gazebo with its version, its physics engine, and ArduCopter's version."""
    (engine,) = manifest["engines"]
    gazebo = engine["gazebo"]
    found = Gazebo(Flavour(gazebo["flavour"]), gazebo["version"], Path(gazebo["program"]))
    return {"gazebo": found.title, "physics": gazebo["physics"], "arducopter": engine["version"]}


def summarise(rows: Sequence[Mapping[str, float]]) -> Row:
    """The medians of the windows of one fleet, with the inverse of the median factor, and all factors."""
    found: Row = {name: round(median(row[name] for row in rows), 4) for name in rows[0]}
    factors = [round(row["real_time_factor"], 3) for row in rows]
    return {**found, "inverse": round(1.0 / median(row["real_time_factor"] for row in rows), 4), "factors": factors}


def largest_in_real_time(rows: Sequence[Row], physics: str = "gazebo") -> dict[str, float | int | None]:
    """How many aircraft run in real time: `measured` is the largest number of the rows with a factor of at least 1
    (`None` without one). `interpolated` is where the line between it and the next number, in the inverse factor,
    reaches 1; `None` if no larger number was measured, and then there may be more, or none that is in real time.
    """
    ordered = sorted(rows, key=lambda row: row["vehicles"])
    inverse = [(row["vehicles"], 1.0 / row[physics]["real_time_factor"]) for row in ordered]
    # the first that is too slow bounds it: a larger one that is faster shows noise
    slow = next((place for place, (_, value) in enumerate(inverse) if value > 1.0), len(inverse))
    if slow == 0:
        return {"measured": None, "interpolated": None}
    below = inverse[slow - 1]
    if slow == len(inverse):
        return {"measured": below[0], "interpolated": None}
    above = inverse[slow]
    share = (1.0 - below[1]) / (above[1] - below[1])
    return {"measured": below[0], "interpolated": round(below[0] + share * (above[0] - below[0]), 1)}


def measure_fleets(
    numbers: Sequence[int],
    measure_one: Callable[[int], Row],
    on_row: Callable[[Row], None] | None = None,
) -> list[Row]:
    """A row of `measure_one` for each of the ascending `numbers`, until one is slower than `TOO_SLOW` in Gazebo."""
    rows: list[Row] = []
    for count in sorted(set(numbers)):
        rows.append(measure_one(count))
        if on_row is not None:
            on_row(rows[-1])
        if rows[-1]["gazebo"]["real_time_factor"] < TOO_SLOW:
            break
    return rows


def measure_all(
    numbers: Sequence[int],
    measure_one: Callable[[int], Row],
    collide: Callable[[str], Row] | None = None,
    on_row: Callable[[Row], None] | None = None,
) -> Row:
    """The document of the benchmark, plain data for JSON: `machine` and its load averages before and after, `rows` of
    `measure_one`, `real_time` (`largest_in_real_time` of each physics), and `collisions` of `collide` for each physics.
    """
    machine = describe_machine()
    load_before = os.getloadavg()[0]
    rows = measure_fleets(numbers, measure_one, on_row)
    return {
        "machine": machine.model_dump(mode="json"),
        "rows": rows,
        "real_time": {physics: largest_in_real_time(rows, physics) for physics in PHYSICS},
        "published": {"vehicles": PUBLISHED_VEHICLES, "source": PUBLISHED},
        "collisions": [] if collide is None else [collide(physics) for physics in PHYSICS],
        "loadavg": [round(load_before, 2), round(os.getloadavg()[0], 2)],
    }
