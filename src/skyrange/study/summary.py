"""What does one want to know first about a run? Its facts as plain data, for people and for scripts."""

from __future__ import annotations

from typing import Any

from skyrange.core.time import NS_PER_S
from skyrange.record import RunRecord
from skyrange.study.linkstats import link_stats
from skyrange.study.marks import alarming, said, told_once, undoing
from skyrange.study.series import EMPTY_TRACK, happenings, truth_tracks


def summary(record: RunRecord) -> dict[str, Any]:
    """The run's facts; works on killed and empty runs.

    Per vehicle: `outcome` (complete, failed or unfinished) with `reason` (what its ground station made of it) and
    `finished_s`; `mishap`, its first collision or crash in words, `None` without one;
    `distance_m` and `highest_m` from the recorded truth (so of its sampling rate); how many frames of
    its autopilot were sent on the `gcs` link towards its ground station and how many arrived there.
    `mishaps` are collisions (once for both), crashes, fence breaches and failsafes in time order, with their event's
    details.
    """
    manifest = record.manifest
    tracks = truth_tracks(record)
    links = link_stats(record)
    up = {stats.owner: stats for stats in links if (stats.kind, stats.direction) == ("gcs", "rev")}
    outcomes = record.outcomes
    events = happenings(record, "events")
    ends = undoing(events)
    vehicles = []
    for vehicle in manifest.get("vehicles") or []:
        name = vehicle["id"]
        outcome = outcomes.get(name, {})
        track = tracks.get(name, EMPTY_TRACK)
        to_station = up.get(name)
        vehicles.append(
            {
                "id": name,
                "operator": vehicle["operator"],
                "autopilot": vehicle.get("autopilot"),
                "outcome": outcome.get("state") or "unfinished",
                "reason": outcome.get("reason") or "",
                "finished_s": outcome.get("finished_s"),
                "mishap": ends.get(name),
                "distance_m": round(track.distance_m, 3),
                "highest_m": round(float(track.enu_m[:, 2].max(initial=0.0)), 3),
                "frames_sent": to_station.sent if to_station else 0,
                "frames_received": to_station.delivered if to_station else 0,
            }
        )
    mishaps = [
        {
            "time_s": row.time_ns / NS_PER_S,
            "kind": alarming(row),
            "vehicle": row.about,
            "data": dict(row.data),
            "words": said(row),
        }
        for row in told_once(events)
    ]
    digests = manifest.get("digests") or {}
    report = record.path / "report.html"
    return {
        "name": manifest.get("name") or record.path.name,
        "status": record.status,
        "seed": manifest.get("seed"),
        "simulated_s": record.duration,
        "duration_s": manifest.get("duration_s"),
        "frames": sum(stats.sent for stats in links),
        "fingerprint": digests.get("fingerprint"),
        "digests": digests,
        "timings": manifest.get("timings") or {},
        "vehicles": vehicles,
        "mishaps": mishaps,
        "path": str(record.path),
        "report": str(report) if report.exists() else None,
    }
