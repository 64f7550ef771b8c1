"""Flights of scenarios in the range's own physics and in Gazebo's, with one seed, and what differs between them
by their truth and events.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.assembly.build import build
from skyrange.core.files import atomic_write
from skyrange.core.time import NS_PER_S
from skyrange.metrics.paths import AIRBORNE_M
from skyrange.metrics.time_series import Vehicle, read_notes, vehicles
from skyrange.parity.flights import with_autopilot
from skyrange.record import RunRecord
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly

Floats = NDArray[np.float64]

_COLUMNS: Final = (
    "east_m", "north_m", "up_m", "wind_east_mps", "wind_north_mps", "wind_up_mps",
    "vel_east_mps", "vel_north_mps", "vel_up_mps", "qx", "qy", "charge", "on_ground",
)  # fmt: skip
_STANDING_S: Final = 1.0
"""From this time after the touchdown on, an aircraft that still moves slides."""


@dataclass(frozen=True, slots=True)
class Collision:
    """A collision of two aircraft, or of one with a building (`building:` and its number)."""

    time_s: float
    first: str
    second: str
    speed_mps: float
    energy_j: float
    up_m: float


@dataclass(frozen=True, slots=True)
class FlownAircraft:
    """One aircraft in one run: its states at equal intervals of time, from 0 on.

    `time_s` (n,); `enu_m`, `air_mps` and `velocity_mps` (n, 3): the place of its gear, the air around it, its own
    velocity; `tilt_deg`, `charge` (0 to 1) and `on_ground` (n,).
    """

    vehicle: str
    airframe: str
    outcome: str
    home_m: float
    time_s: Floats
    enu_m: Floats
    air_mps: Floats
    velocity_mps: Floats
    tilt_deg: Floats
    charge: Floats
    on_ground: NDArray[np.bool_]

    @property
    def standing_drift_m(self) -> float:
        """How far it moved in the plane while it stood: before its take-off or after its landing, whichever is more."""
        aloft_s = self.time_s[~self.on_ground]
        if not len(aloft_s):
            return 0.0
        spans = self.time_s < aloft_s[0], self.time_s > aloft_s[-1] + _STANDING_S
        places = [self.enu_m[span, :2] for span in spans if span.any()]
        return max((float(np.linalg.norm(at - at[0], axis=1).max()) for at in places), default=0.0)

    def down_after_s(self, hit_s: float) -> float | None:
        """Seconds from `hit_s` until it is on the ground; `None` if it is still in the air at the end."""
        down_s = self.time_s[(self.time_s >= hit_s) & self.on_ground]
        return float(down_s[0]) - hit_s if len(down_s) else None


@dataclass(frozen=True, slots=True)
class AircraftDifference:
    """One aircraft in two runs. Pairs have the first run's value first.

    Distances are between the places at equal times while at least one of both is in the air, up to the first collision
    of the aircraft in either run (`until_s`; `None` without one). `end_apart_m` is the distance at the end of that
    time, on the ground if it has landed. Up to then are also `measures`: `lift_off_s`, `landed_s` (not if it collided),
    the greatest height, speed, climb, descent and tilt, and the share of the battery that was used. `air_rms_mps` is
    the RMS of the difference of the air's velocity at the two aircraft, `gust_rms_mps` that of the first one's gusts.
    `down_after_s` are seconds from the first collision of each run to the ground.
    """

    vehicle: str
    airframe: str
    outcomes: tuple[str, str]
    until_s: float | None
    largest_m: float
    largest_at_s: float
    rms_m: float
    end_apart_m: float
    standing_drift_m: tuple[float, float]
    down_after_s: tuple[float | None, float | None]
    air_rms_mps: float
    gust_rms_mps: float
    measures: Mapping[str, tuple[float, float]]


@dataclass(frozen=True, slots=True)
class RunDifference:
    """Two runs of one scenario: every aircraft that is in both, and the collisions of each run."""

    aircraft: tuple[AircraftDifference, ...]
    collisions: tuple[tuple[Collision, ...], tuple[Collision, ...]]


def compare_runs(first: RunRecord, second: RunRecord) -> RunDifference:
    """How the aircraft of `second` flew differently from those of `first`. Both record truth at one rate."""
    collisions = read_collisions(first), read_collisions(second)
    mine, theirs = read_flights(first), read_flights(second)
    aircraft = []
    for vehicle, own in mine.items():
        if vehicle in theirs:
            hits_s = _first_hit_s(collisions[0], vehicle), _first_hit_s(collisions[1], vehicle)
            aircraft.append(compare_aircraft((own, theirs[vehicle]), hits_s))
    return RunDifference(tuple(aircraft), collisions)


def _first_hit_s(collisions: Sequence[Collision], vehicle: str) -> float | None:
    return min((hit.time_s for hit in collisions if vehicle in (hit.first, hit.second)), default=None)


def read_collisions(record: RunRecord) -> tuple[Collision, ...]:
    """The collisions of a run in order of time, each once."""
    return tuple(
        Collision(
            note.time_ns / NS_PER_S,
            note.about,
            str(note.data["with"]),
            float(note.data["speed_mps"]),
            float(note.data["energy_j"]),
            float(note.data["up_m"]),
        )
        for note in read_notes(record, "events")
        # each aircraft has an event of its own
        if note.kind == "event.collision" and (note.about < note.data["with"] or "/" not in note.data["with"])
    )


def read_flights(record: RunRecord) -> dict[str, FlownAircraft]:
    """Every aircraft of a run, by its id."""
    table = record.table("truth", ["time_ns", "vehicle", *_COLUMNS])
    names = np.asarray(table.column("vehicle").to_pylist())
    time_s = table.column("time_ns").to_numpy() / NS_PER_S
    rows = np.stack([table.column(name).to_numpy().astype(np.float64) for name in _COLUMNS], axis=1)
    return {
        vehicle.id: _flown(vehicle, record, time_s[names == vehicle.id], rows[names == vehicle.id])
        for vehicle in vehicles(record)
    }


def _flown(vehicle: Vehicle, record: RunRecord, time_s: Floats, rows: Floats) -> FlownAircraft:
    qx, qy, charge, on_ground = rows[:, 9:].T
    return FlownAircraft(
        vehicle=vehicle.id,
        airframe=vehicle.airframe,
        outcome=str(record.outcomes.get(vehicle.id, {}).get("state") or "unfinished"),
        home_m=vehicle.home_enu_m[2] if vehicle.home_enu_m is not None else 0.0,
        time_s=time_s,
        enu_m=rows[:, 0:3],
        air_mps=rows[:, 3:6],
        velocity_mps=rows[:, 6:9],
        tilt_deg=np.degrees(np.arccos(np.clip(1.0 - 2.0 * (qx * qx + qy * qy), -1.0, 1.0))),
        charge=charge,
        on_ground=on_ground != 0.0,
    )


def compare_aircraft(
    flown: tuple[FlownAircraft, FlownAircraft], hits_s: tuple[float | None, float | None]
) -> AircraftDifference:
    """How one aircraft flew in two runs; `hits_s` is the time of its first collision in each."""
    own, other = flown
    until_s = min((hit_s for hit_s in hits_s if hit_s is not None), default=None)
    count = min(len(own.time_s), len(other.time_s))  # both begin at 0, at one rate
    if until_s is not None:
        count = min(count, int(np.searchsorted(own.time_s, until_s)))
    apart_m = np.linalg.norm(own.enu_m[:count] - other.enu_m[:count], axis=1)
    aloft = ~(own.on_ground[:count] & other.on_ground[:count])
    farthest = int(np.argmax(np.where(aloft, apart_m, 0.0)))
    gusts = own.air_mps[:count] - own.air_mps[:count].mean(axis=0)
    sides = [_measures(each, count, whole=until_s is None) for each in flown]
    return AircraftDifference(
        vehicle=own.vehicle,
        airframe=own.airframe,
        outcomes=(own.outcome, other.outcome),
        until_s=until_s,
        largest_m=float(apart_m[farthest]) if aloft.any() else 0.0,
        largest_at_s=float(own.time_s[farthest]),
        rms_m=float(np.sqrt((apart_m[aloft] ** 2).mean())) if aloft.any() else 0.0,
        end_apart_m=float(apart_m[-1]),
        standing_drift_m=(own.standing_drift_m, other.standing_drift_m),
        down_after_s=(_down_after(own, hits_s[0]), _down_after(other, hits_s[1])),
        air_rms_mps=_rms(own.air_mps[:count] - other.air_mps[:count]),
        gust_rms_mps=_rms(gusts),
        measures={name: (value, sides[1][name]) for name, value in sides[0].items() if name in sides[1]},
    )


def _down_after(flown: FlownAircraft, hit_s: float | None) -> float | None:
    return None if hit_s is None else flown.down_after_s(hit_s)


def _rms(vectors: Floats) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def _measures(flown: FlownAircraft, count: int, *, whole: bool) -> dict[str, float]:
    """Measures of the first `count` states; empty if it did not fly."""
    up_m, velocity_mps = flown.enu_m[:count, 2], flown.velocity_mps[:count]
    airborne_s = flown.time_s[:count][up_m > flown.home_m + AIRBORNE_M]
    if not len(airborne_s):
        return {}
    measures = {"lift_off_s": float(airborne_s[0])}
    if whole and flown.on_ground[-1]:
        measures["landed_s"] = float(flown.time_s[~flown.on_ground][-1])
    return measures | {
        "height_max_m": float(up_m.max()),
        "speed_max_mps": float(np.hypot(velocity_mps[:, 0], velocity_mps[:, 1]).max()),
        "climb_max_mps": float(velocity_mps[:, 2].max()),
        "descent_max_mps": float(-velocity_mps[:, 2].min()),
        "tilt_max_deg": float(flown.tilt_deg[:count].max()),
        "charge_used": float(flown.charge[0] - flown.charge[count - 1]),
    }


OnStep = Callable[[str, int, int], None]
"""Called with what is being done, how many steps are done, and how many there are."""

SCENARIOS: Final = ("squares", "head-on", "wind")
"""Shipped scenarios that are compared unless others are named."""
FINE_STEPS: Final = 5
"""Steps of Gazebo in a tick, in the runs that show what the length of a step changes."""
RESULTS: Final = "physics.json"


@dataclass(frozen=True, slots=True)
class ComparedScenario:
    """A scenario in both. `repeated` is a second run in Gazebo against the first, `fine` one with `FINE_STEPS` steps
    in each tick against the first; `None` if these were not flown.
    """

    name: str
    title: str
    duration_s: float
    seed: int
    difference: RunDifference
    repeated: RunDifference | None = None
    fine: RunDifference | None = None


@dataclass(frozen=True, slots=True)
class PhysicsComparison:
    """All scenarios, and the versions of the programs that flew them."""

    scenarios: tuple[ComparedScenario, ...]
    gazebo: str
    """Its name and version ("Gazebo 11.1.0")."""
    physics: str
    """Physics engine of Gazebo ("ode")."""
    arducopter: str


def compare(
    folder: Path,
    names: Sequence[str] = SCENARIOS,
    changes: Sequence[str] = (),
    *,
    again: str = SCENARIOS[0],
    on_step: OnStep | None = None,
) -> PhysicsComparison:
    """Fly the scenarios `names`, shipped ones or files, with ArduCopter in both kinds of physics, into `folder`.

    The scenario `again` is flown twice more in Gazebo: unchanged, and with finer steps. Raises `InputError` without
    Gazebo, its plugin or ArduCopter, and the errors of `study.runs.fly`.
    """
    loaded = {name: load(name, changes) for name in names}
    runs = [
        (name, kind, steps)
        for name in names
        for kind, steps in (
            ("ardupilot", 1),
            ("gazebo", 1),
            *([("again", 1), ("fine", FINE_STEPS)] if name == again else []),
        )
    ]
    scenarios = [(f"{loaded[name].name}-{kind}", _in_physics(loaded[name], kind, steps)) for name, kind, steps in runs]
    for _, scenario in scenarios:
        build(scenario).close()  # raises errors in the last one before the first one flies
    flown: dict[tuple[str, str], RunRecord] = {}
    for done, ((name, kind, _), (place, scenario)) in enumerate(zip(runs, scenarios, strict=True)):
        if on_step is not None:
            on_step(f"{scenario.name}, {kind}", done, len(runs))
        flown[name, kind] = fly(scenario, folder / place, report=False)
    compared = tuple(
        ComparedScenario(
            name=Path(name).stem,
            title=loaded[name].name,
            duration_s=loaded[name].duration_s,
            seed=loaded[name].seed,
            difference=compare_runs(flown[name, "ardupilot"], flown[name, "gazebo"]),
            repeated=_against(flown, name, "again"),
            fine=_against(flown, name, "fine"),
        )
        for name in names
    )
    (engine,) = flown[names[0], "gazebo"].manifest["engines"]
    gazebo = engine["gazebo"]
    title = f"Gazebo {'Sim ' if gazebo['flavour'] == 'sim' else ''}{gazebo['version']}"
    comparison = PhysicsComparison(compared, title, gazebo["physics"], engine["version"])
    with atomic_write(folder / RESULTS) as file:
        file.write(json.dumps(results(comparison), indent=1).encode())
    return comparison


def results(comparison: PhysicsComparison) -> dict[str, Any]:
    """All differences as plain data."""
    return asdict(comparison)


def _in_physics(scenario: Scenario, kind: str, steps: int) -> Scenario:
    if kind == "ardupilot":
        return with_autopilot(scenario, kind)
    options = {"steps_per_tick": steps}
    autopilots = scenario.autopilots.with_options("gazebo", options, f"{scenario.name} in Gazebo")
    return with_autopilot(scenario.model_copy(update={"autopilots": autopilots}), "gazebo")


def _against(flown: dict[tuple[str, str], RunRecord], name: str, kind: str) -> RunDifference | None:
    return compare_runs(flown[name, "gazebo"], flown[name, kind]) if (name, kind) in flown else None
