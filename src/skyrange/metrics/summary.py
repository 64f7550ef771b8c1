"""Summary of a run as plain data, for the terminal and for scripts, and of the flight of each aircraft."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc

from skyrange.contracts.frames import Fate
from skyrange.core.ids import endpoint
from skyrange.core.time import NS_PER_S
from skyrange.metrics.defences import remote_id_trust
from skyrange.metrics.links import link_statistics
from skyrange.metrics.safety import describe_mishap, distinct_mishaps, find_landings_s, first_mishaps, mishap_kind
from skyrange.metrics.time_series import (
    EMPTY_TRACK,
    Record,
    RecordedNote,
    Track,
    Vehicle,
    belief_errors_m,
    read_notes,
    truth_tracks,
)
from skyrange.record import RunRecord
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
        vehicle_events = [event for event in events if event.about.split(".", 1)[0] == vehicle.id]
        outcome = outcomes.get(vehicle.id) or {}
        finished = outcome.get("finished_s")
        path = truth.get(vehicle.id)
        believed = belief.get(vehicle.id)
        gaps = (
            belief_errors_m(path, believed) if path is not None and believed is not None and len(path) else np.zeros(0)
        )
        rows.append(
            FlightSummary(
                vehicle=vehicle,
                state=str(outcome.get("state") or "unfinished"),
                reason=str(outcome.get("reason") or ""),
                mishap=ends.get(vehicle.id, ""),
                finished_s=None if finished is None else float(finished),
                landed_s=find_landings_s(vehicle_events, {vehicle.id: {"finished_s": finished}}).get(vehicle.id),
                airborne_s=_airborne_s(vehicle_events, path),
                distance_m=path.distance_m if path is not None else 0.0,
                max_up_m=float(path.enu_m[:, 2].max()) if path is not None and len(path) else None,
                max_speed_mps=float(path.speed_mps.max()) if path is not None and len(path) else None,
                max_gap_m=float(gaps.max()) if len(gaps) else None,
                p95_gap_m=float(np.quantile(gaps, 0.95)) if len(gaps) else None,
                positions=len(believed) if believed is not None else 0,
            )
        )
    return rows


def describe_missions(states: Sequence[str]) -> str:
    """How many missions are complete, such as "3 of 5 missions"; `states` are those of the outcomes of all aircraft."""
    return f"{sum(state == 'complete' for state in states)} of {len(states)} missions"


_DOWN = frozenset({"event.landed", "event.crash", "event.disarmed"})


def _airborne_s(events: Sequence[RecordedNote], path: Track | None) -> float | None:
    """Seconds from take-offs to landings, crashes or disarming; an unfinished flight counts to the end of truth."""
    total, since = 0, None
    flew = False
    for event in events:
        if event.kind == "event.takeoff" and since is None:
            since, flew = event.time_ns, True
        elif event.kind in _DOWN and since is not None:
            total, since = total + event.time_ns - since, None
    if since is not None and path is not None and len(path):
        total += max(0, int(path.time_ns[-1]) - since)
    return total / NS_PER_S if flew else None


FORK_FOUND = "decision.fork_found"


def summary(record: RunRecord) -> dict[str, Any]:
    """The summary of a run; works for killed and empty runs too.

    Per vehicle: `outcome` (complete, failed or unfinished) with `reason` (as its ground station gives it) and
    `finished_s`, the time of that report, which follows the heartbeats; `landed_s`, when it touched down to end the
    mission, to the world's tick; `mishap`, its first collision or crash in words, `None` without one; `distance_m` and
    `highest_m` from the recorded truth, which depend on its sampling rate; the numbers of frames that were sent on the
    `gcs` link towards its ground station and that arrived there. Of a ground station outside the range
    (`station_outside`) nobody records what arrives: `frames_received` are then those that were handed to its socket.
    `frames_from_station` are the frames of the ground station that arrived at the aircraft. `mishaps` are collisions
    (once for both aircraft), crashes, fence breaches and failsafes in order of time, with the details of their events.
    `city` is the manifest's entry: the buildings, and what was kept and dropped of their file; `None` without a city.
    `placing` has a row for each aircraft and receiver that was moved.
    `mission_files` says what is used of each mission file, and what is ignored.
    `trust` says how long receivers that verify Remote ID took until they trusted aircraft that sign (`measures.trust`);
    `None` if none does. `equivocators` are operators of which a hashgraph has a proof that they signed two events with
    one self-parent.
    `cores` says on how many cores the run was, `None` where one was asked for.
    `disk` gives the bytes of each table and of other files of the folder, the most first. `level` is that of the
    record: at `summary`, distances, heights and the frames of each aircraft are `None`, and `frames` is `None` until
    the run ends.
    """
    manifest = record.manifest
    has_truth, has_links = record.keeps("truth"), record.keeps("features")
    tracks = truth_tracks(record) if has_truth else {}
    links = link_statistics(record) if has_links else []
    downlinks = {stats.owner: stats for stats in links if (stats.kind, stats.direction) == ("gcs", "rev")}
    uplinks = {stats.owner: stats for stats in links if (stats.kind, stats.direction) == ("gcs", "fwd")}
    outside = set((manifest.get("live") or {}).get("outside") or ())
    outcomes = record.outcomes
    events = read_notes(record, "events")
    ends = first_mishaps(events)
    landings_s = find_landings_s(events, outcomes)
    vehicles = []
    for vehicle in manifest.get("vehicles") or []:
        name = vehicle["id"]
        outcome = outcomes.get(name, {})
        track = tracks.get(name, EMPTY_TRACK)
        downlink, uplink = downlinks.get(name), uplinks.get(name)
        is_outside = endpoint(vehicle["operator"], "gcs") in outside
        received = (downlink.delivered if downlink else 0) if has_links else None
        if downlink and is_outside and received is not None:  # nobody records what arrives there
            received += downlink.fates.get(Fate.IN_FLIGHT, 0)
        vehicles.append(
            {
                "id": name,
                "operator": vehicle["operator"],
                "autopilot": vehicle.get("autopilot"),
                "outcome": outcome.get("state") or "unfinished",
                "reason": outcome.get("reason") or "",
                "finished_s": outcome.get("finished_s"),
                "landed_s": landings_s.get(name),
                "mishap": ends.get(name),
                "distance_m": round(track.distance_m, 3) if has_truth else None,
                "highest_m": round(float(track.enu_m[:, 2].max(initial=0.0)), 3) if has_truth else None,
                "frames_sent": (downlink.sent if downlink else 0) if has_links else None,
                "frames_received": received,
                "station_outside": is_outside,
                "frames_from_station": (uplink.delivered if uplink else 0) if has_links else None,
            }
        )
    mishaps = [
        {
            "time_s": row.time_ns / NS_PER_S,
            "kind": mishap_kind(row),
            "vehicle": row.about,
            "data": dict(row.data),
            "words": describe_mishap(row),
        }
        for row in distinct_mishaps(events)
    ]
    trust = remote_id_trust(record)
    digests = manifest.get("digests") or {}
    report = record.path / "report.html"
    return {
        "name": manifest.get("name") or record.path.name,
        "status": record.status,
        "seed": manifest.get("seed"),
        "simulated_s": record.duration,
        "duration_s": manifest.get("duration_s"),
        "level": record.level,
        "frames": sum(stats.sent for stats in links) if has_links else (manifest.get("not_kept") or {}).get("frames"),
        "fingerprint": digests.get("fingerprint"),
        "digests": digests,
        "timings": manifest.get("timings") or {},
        "cores": manifest.get("cores"),
        "city": manifest.get("city"),
        "mission_files": manifest.get("mission_files") or [],
        "placing": manifest.get("placing") or [],
        "warnings": manifest.get("warnings") or [],
        "radio": describe_radio_engine(manifest),
        "trust": trust.facts() if trust.pairs else None,
        "equivocators": _equivocators(record),
        "vehicles": vehicles,
        "mishaps": mishaps,
        "disk": measure_disk(record.path),
        "path": str(record.path),
        "report": str(report) if report.exists() else None,
    }


def _equivocators(record: RunRecord) -> list[str]:
    decisions = record.table("decisions", ["kind", "about"])
    forks = decisions.filter(pc.equal(decisions.column("kind"), FORK_FOUND))
    return sorted(set(forks.column("about").to_pylist()))


def measure_disk(folder: Path) -> dict[str, int]:
    """Bytes by table or subfolder of a run's folder, the most first; other files go by their names."""
    sizes: dict[str, int] = {}
    for path in folder.rglob("*"):
        if path.is_file():
            first = path.relative_to(folder).parts[0]
            name = first.removesuffix(".parquet")
            sizes[name] = sizes.get(name, 0) + path.stat().st_size
    return dict(sorted(sizes.items(), key=lambda entry: (-entry[1], entry[0])))


def describe_radio_engine(manifest: Mapping[str, Any]) -> str:
    """The radio engine of a run, if it is another program, and what it leaves to the builtin medium; else ""."""
    medium = manifest.get("medium")
    if not isinstance(medium, Mapping) or not medium.get("engine"):
        return ""
    text = f"{medium['engine']} {medium.get('release', '')}".strip()
    left = [str(name) for name in medium.get("builtin_waveforms") or ()]
    bluetooth = [name for name in left if name.startswith("BLE")]
    others = [name for name in left if name not in bluetooth]
    builtin = ["Bluetooth"] * bool(bluetooth) + others
    if builtin:
        text += f"; {' and '.join(builtin)} by the builtin medium"
    return text
