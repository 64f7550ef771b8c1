"""How did each aircraft's flight go? Outcome, time in the air, path flown, belief against truth, one row each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skyrange.core.time import NS_PER_S
from skyrange.study.marks import undoing
from skyrange.study.series import Happening, Record, Track, Vehicle, gaps_m


@dataclass(frozen=True, slots=True)
class Flight:
    """One aircraft's flight in numbers; `None` where the record does not say.

    `state` is `complete`, `failed` or `unfinished`; `reason` is the ground station's, `mishap` what truly happened: the
    first collision or crash in words, "" without one. `airborne_s` sums the spans from take-off to landing or crash;
    `max_gap_m` and `p95_gap_m` are distances between what its ground station believed on reception and the truth.
    """

    vehicle: Vehicle
    state: str
    reason: str
    mishap: str
    finished_s: float | None
    airborne_s: float | None
    distance_m: float
    max_up_m: float | None
    max_speed_mps: float | None
    max_gap_m: float | None
    p95_gap_m: float | None
    positions: int
    """Positions that the ground station received."""


def flights(
    record: Record,
    fleet: Sequence[Vehicle],
    truth: Mapping[str, Track],
    belief: Mapping[str, Track],
    events: Sequence[Happening],
) -> list[Flight]:
    """One `Flight` per aircraft of `fleet`; outcomes from the manifest, else from `event.outcome`."""
    rows = []
    declared = record.manifest.get("outcomes") or {}
    ends = undoing(events)
    for vehicle in fleet:
        own = [event for event in events if event.about.split(".", 1)[0] == vehicle.id]
        said = [event for event in own if event.kind == "event.outcome"]
        outcome = declared.get(vehicle.id) or (dict(said[-1].data) if said else {})
        finished = outcome.get("finished_s", said[-1].time_ns / NS_PER_S if said else None)
        path = truth.get(vehicle.id)
        seen = belief.get(vehicle.id)
        gaps = gaps_m(path, seen) if path is not None and seen is not None and len(path) else np.zeros(0)
        rows.append(
            Flight(
                vehicle=vehicle,
                state=str(outcome.get("state") or "unfinished"),
                reason=str(outcome.get("reason") or ""),
                mishap=ends.get(vehicle.id, ""),
                finished_s=None if finished is None else float(finished),
                airborne_s=_airborne_s(own, path),
                distance_m=path.distance_m if path is not None else 0.0,
                max_up_m=float(path.enu_m[:, 2].max()) if path is not None and len(path) else None,
                max_speed_mps=float(path.speed_mps.max()) if path is not None and len(path) else None,
                max_gap_m=float(gaps.max()) if len(gaps) else None,
                p95_gap_m=float(np.quantile(gaps, 0.95)) if len(gaps) else None,
                positions=len(seen) if seen is not None else 0,
            )
        )
    return rows


_DOWN = frozenset({"event.landed", "event.crash", "event.disarmed"})


def _airborne_s(own: Sequence[Happening], path: Track | None) -> float | None:
    """Seconds between take-offs and landings, crashes or motors off; an unfinished flight counts to its truth's end."""
    total, since = 0, None
    flew = False
    for event in own:
        if event.kind == "event.takeoff" and since is None:
            since, flew = event.time_ns, True
        elif event.kind in _DOWN and since is not None:
            total, since = total + event.time_ns - since, None
    if since is not None and path is not None and len(path):
        total += max(0, int(path.time_ns[-1]) - since)
    return total / NS_PER_S if flew else None
