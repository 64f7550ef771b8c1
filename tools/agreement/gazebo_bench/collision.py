"""Benchmark of a collision: two aircraft toward each other, in Gazebo and in the range's own physics."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np

from skyrange.bench.isolation import run_in_process
from skyrange.core.errors import ComponentError
from skyrange.core.time import NS_PER_S, to_seconds
from skyrange.record import load as load_record
from skyrange.runtime.run import Run
from skyrange.scenario.model.fleet import Autopilots
from skyrange.scenario.model.scenario import Operator, Origin, Record, Scenario, Sensors, Start, Vehicle, path
from skyrange.world.world import World
from tools.agreement.gazebo_bench.fleets import PHYSICS, versions
from tools.agreement.physics.comparison import read_collisions

Row = dict[str, Any]

APART_M: Final = 60.0
ALT_M: Final = 30.0
SPEED_MPS: Final = 5.0
DURATION_S: Final = 60.0
"""They meet by then: they climb for some 15 s after the departure at 10 s, and fly 30 m each."""
FALL_S: Final = 10.0
"""How long the flight goes on after the contact."""
_STEP_S: Final = 0.1
_BEFORE_S: Final = 0.1
_AFTER_S: Final = (0.5, 1.0, 2.0)


def collision_scenario(physics: str, *, window: bool = False) -> Scenario:
    """Two aircraft of two operators, 60 m apart, that fly at 5 m/s toward each other 30 m high, and over each other's
    start. Their sensors are ideal and the air is still, so they meet.
    """
    autopilot = PHYSICS[physics]
    shown = {"window": True} if window and physics == "gazebo" else {}

    def flown(name: str, east_m: float, heading_deg: float) -> Operator:
        goal_m = -2.0 * east_m  # relative to its start
        one = Vehicle(
            id=name,
            start=Start(east_m=east_m, heading_deg=heading_deg),
            plan=path([(0.0, 0.0), (goal_m, 0.0)], alt_m=ALT_M, speed_mps=SPEED_MPS),
            autopilot=autopilot,
            depart_s=10.0,
        )
        return Operator(id=name, vehicles=(one,))

    return Scenario(
        name=f"bench collision {physics}",
        duration_s=DURATION_S,
        origin=Origin(lat=40.7780, lon=-73.9550),
        operators=(flown("left", -0.5 * APART_M, 90.0), flown("right", 0.5 * APART_M, 270.0)),
        sensors=Sensors(noise=0.0),
        record=Record(truth_hz=100.0),
        autopilots=Autopilots().with_options(autopilot, shown, "bench"),
    )


def measure(physics: str, *, window: bool = False, out: Path | None = None) -> Row:
    """The collision in Gazebo ("gazebo") or in the range's own physics ("range"), flown in a process of its own.

    `time_s` is that of the first contact, `speed_mps` the relative speed at it and `energy_j` ½ of the reduced mass
    times its square. For each aircraft: `lost_motors`, counted from 0, right after it; `height_before_m` 0.1 s before
    it, `heights_after_m` after 0.5, 1 and 2 s; `tilt_after_deg` at the same times; `fell_s` the time until it was on
    the ground, `None` if it still flew after 10 s; `crashed`; and `outcome`. With `out` the run folder is kept there.
    Raises `InputError` without Gazebo or ArduCopter, `ComponentError` if they did not meet.
    """
    return run_in_process(f"bench of a collision, {physics}", _flown, physics, out, window=window)


def _flown(physics: str, out: Path | None, *, window: bool) -> Row:
    with tempfile.TemporaryDirectory() as scratch:
        folder = out if out is not None else Path(scratch) / "run"
        run = Run.start(collision_scenario(physics, window=window), folder)
        try:
            lost = _meet(run)
            run.advance(min(to_seconds(run.now) + FALL_S, DURATION_S))
        finally:
            run.finish()
        record = load_record(folder)
        hits = read_collisions(record)
        if not hits:
            raise ComponentError("gazebo-speed", f"the two aircraft did not meet within {DURATION_S:g} s in {physics}")
        hit = hits[0]
        row: Row = {"physics": physics, "time_s": hit.time_s, "up_m": round(hit.up_m, 3)}
        row |= {"speed_mps": round(hit.speed_mps, 3), "energy_j": round(hit.energy_j, 2), "aircraft": {}}
        for vehicle, motors in lost.items():
            outcome = str(record.outcomes.get(vehicle, {}).get("state") or "unfinished")
            row["aircraft"][vehicle] = {"lost_motors": motors, **_fall(record, vehicle, hit.time_s), "outcome": outcome}
        if physics == "gazebo":
            row["versions"] = versions(record.manifest)
        return row


def _meet(run: Run) -> dict[str, list[int]]:
    """Advance until motors are lost, or to the end; the lost motors of every aircraft."""
    world = run.built.wiring.world
    assert isinstance(world, World)
    lost: dict[str, list[int]] = {}
    while to_seconds(run.now) < DURATION_S and not any(lost.values()):
        run.advance(to_seconds(run.now) + _STEP_S)
        lost = {vehicle: world.lost_motors(vehicle) for vehicle in world.vehicles}
    return lost


def _fall(record: Any, vehicle: str, hit_s: float) -> Row:
    columns = ["time_ns", "vehicle", "up_m", "qx", "qy", "on_ground", "crashed"]
    table = record.table("truth", columns)
    rows = np.stack(
        [table.column(name).to_numpy().astype(np.float64) for name in columns if name != "vehicle"], axis=1
    )[np.asarray(table.column("vehicle").to_pylist()) == vehicle]
    time_s, up_m = rows[:, 0] / NS_PER_S, rows[:, 1]
    tilt_deg = np.degrees(np.arccos(np.clip(1.0 - 2.0 * (rows[:, 2] ** 2 + rows[:, 3] ** 2), -1.0, 1.0)))
    landed_s = time_s[(time_s > hit_s) & (rows[:, 4] == 1.0)]

    def at(values: Any, after_s: float) -> float:
        return round(float(np.interp(hit_s + after_s, time_s, values)), 2)

    return {
        "height_before_m": at(up_m, -_BEFORE_S),
        "heights_after_m": [at(up_m, after_s) for after_s in _AFTER_S],
        "tilt_after_deg": [at(tilt_deg, after_s) for after_s in _AFTER_S],
        "fell_s": round(float(landed_s[0]) - hit_s, 2) if len(landed_s) else None,
        "crashed": bool(rows[-1, 5]),
    }
