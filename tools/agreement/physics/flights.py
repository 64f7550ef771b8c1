"""Comparison of two runs of one scenario whose aircraft two kinds of physics moved, from their truth and events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.metrics.paths import AIRBORNE_M
from skyrange.metrics.time_series import Vehicle, read_notes, vehicles
from skyrange.record import RunRecord

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
    found = []
    for vehicle, one in mine.items():
        if vehicle in theirs:
            hits_s = _first_hit_s(collisions[0], vehicle), _first_hit_s(collisions[1], vehicle)
            found.append(compare_aircraft((one, theirs[vehicle]), hits_s))
    return RunDifference(tuple(found), collisions)


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
    return {one.id: _flown(one, record, time_s[names == one.id], rows[names == one.id]) for one in vehicles(record)}


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
    one, other = flown
    until_s = min((hit_s for hit_s in hits_s if hit_s is not None), default=None)
    count = min(len(one.time_s), len(other.time_s))  # both begin at 0, at one rate
    if until_s is not None:
        count = min(count, int(np.searchsorted(one.time_s, until_s)))
    apart_m = np.linalg.norm(one.enu_m[:count] - other.enu_m[:count], axis=1)
    aloft = ~(one.on_ground[:count] & other.on_ground[:count])
    farthest = int(np.argmax(np.where(aloft, apart_m, 0.0)))
    gusts = one.air_mps[:count] - one.air_mps[:count].mean(axis=0)
    sides = [_measures(each, count, until_s is None) for each in flown]
    return AircraftDifference(
        vehicle=one.vehicle,
        airframe=one.airframe,
        outcomes=(one.outcome, other.outcome),
        until_s=until_s,
        largest_m=float(apart_m[farthest]) if aloft.any() else 0.0,
        largest_at_s=float(one.time_s[farthest]),
        rms_m=float(np.sqrt((apart_m[aloft] ** 2).mean())) if aloft.any() else 0.0,
        end_apart_m=float(apart_m[-1]),
        standing_drift_m=(one.standing_drift_m, other.standing_drift_m),
        down_after_s=(_down_after(one, hits_s[0]), _down_after(other, hits_s[1])),
        air_rms_mps=_rms(one.air_mps[:count] - other.air_mps[:count]),
        gust_rms_mps=_rms(gusts),
        measures={name: (value, sides[1][name]) for name, value in sides[0].items() if name in sides[1]},
    )


def _down_after(flown: FlownAircraft, hit_s: float | None) -> float | None:
    return None if hit_s is None else flown.down_after_s(hit_s)


def _rms(vectors: Floats) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def _measures(flown: FlownAircraft, count: int, whole: bool) -> dict[str, float]:
    """Measures of the first `count` states; empty if it did not fly."""
    up_m, velocity_mps = flown.enu_m[:count, 2], flown.velocity_mps[:count]
    airborne_s = flown.time_s[:count][up_m > flown.home_m + AIRBORNE_M]
    if not len(airborne_s):
        return {}
    found = {"lift_off_s": float(airborne_s[0])}
    if whole and flown.on_ground[-1]:
        found["landed_s"] = float(flown.time_s[~flown.on_ground][-1])
    return found | {
        "height_max_m": float(up_m.max()),
        "speed_max_mps": float(np.hypot(velocity_mps[:, 0], velocity_mps[:, 1]).max()),
        "climb_max_mps": float(velocity_mps[:, 2].max()),
        "descent_max_mps": float(-velocity_mps[:, 2].min()),
        "tilt_max_deg": float(flown.tilt_deg[:count].max()),
        "charge_used": float(flown.charge[0] - flown.charge[count - 1]),
    }
