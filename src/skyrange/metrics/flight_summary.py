"""Summary of each aircraft's flight: outcome, time in the air, path length, belief against truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skyrange.core.time import NS_PER_S
from skyrange.metrics.landings import find_landings_s
from skyrange.metrics.mishaps import first_mishaps
from skyrange.metrics.time_series import Record, RecordedNote, Track, Vehicle, belief_errors_m
from skyrange.record.notes import outcomes_of_events


@dataclass(frozen=True, slots=True)
class FlightSummary:
    """One aircraft's flight in numbers; `None` if the record does not contain the data.

    `state` is `complete`, `failed` or `unfinished`. `reason` is the reason that the ground station gives; `mishap`
    describes the aircraft's first true collision or crash, "" if there was none. `finished_s` is when the ground
    station reported the end of the mission, by heartbeats; `landed_s` when the aircraft touched down to end it, to the
    world's tick. `airborne_s` is the sum of the times from take-off to landing or crash. `max_gap_m` and `p95_gap_m`
    are distances between the position that the ground station received and the true position at that time.
    """

    vehicle: Vehicle
    state: str
    reason: str
    mishap: str
    finished_s: float | None
    landed_s: float | None
    airborne_s: float | None
    distance_m: float
    max_up_m: float | None
    max_speed_mps: float | None
    max_gap_m: float | None
    p95_gap_m: float | None
    positions: int
    """Number of positions that the ground station received."""


def summarise_flights(
    record: Record,
    fleet: Sequence[Vehicle],
    truth: Mapping[str, Track],
    belief: Mapping[str, Track],
    events: Sequence[RecordedNote],
) -> list[FlightSummary]:
    """One `FlightSummary` per aircraft of `fleet`; outcomes are from the manifest, else from the events."""
    rows = []
    outcomes = record.manifest.get("outcomes") or outcomes_of_events(
        [vehicle.id for vehicle in fleet],
        ((event.time_ns, event.kind, event.about.split(".", 1)[0], event.data) for event in events),
    )
    ends = first_mishaps(events)
    for vehicle in fleet:
        own = [event for event in events if event.about.split(".", 1)[0] == vehicle.id]
        outcome = outcomes.get(vehicle.id) or {}
        finished = outcome.get("finished_s")
        path = truth.get(vehicle.id)
        seen = belief.get(vehicle.id)
        gaps = belief_errors_m(path, seen) if path is not None and seen is not None and len(path) else np.zeros(0)
        rows.append(
            FlightSummary(
                vehicle=vehicle,
                state=str(outcome.get("state") or "unfinished"),
                reason=str(outcome.get("reason") or ""),
                mishap=ends.get(vehicle.id, ""),
                finished_s=None if finished is None else float(finished),
                landed_s=find_landings_s(own, {vehicle.id: {"finished_s": finished}}).get(vehicle.id),
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


def _airborne_s(own: Sequence[RecordedNote], path: Track | None) -> float | None:
    """Seconds from take-offs to landings, crashes or disarming; an unfinished flight counts to the end of truth."""
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
