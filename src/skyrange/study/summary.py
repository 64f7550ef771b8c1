"""What does one want to know first about a run? Its facts as plain data, for people and for scripts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow.compute as pc

from skyrange.record import RunRecord


def summary(record: RunRecord) -> dict[str, Any]:
    """The run's facts; works on killed and empty runs.

    Per vehicle: `outcome` (complete, failed or unfinished) with `reason` and `finished_s`;
    `distance_m` and `highest_m` from the recorded truth (so of its sampling rate); how many frames of
    its autopilot were sent on the `gcs` link towards its ground station and how many arrived there.
    """
    manifest = record.manifest
    flown = _flown(record)
    sent, received, frames = _frames(record)
    outcomes = record.outcomes
    vehicles = []
    for vehicle in manifest.get("vehicles", []):
        name = vehicle["id"]
        outcome = outcomes.get(name, {})
        distance_m, highest_m = flown.get(name, (0.0, 0.0))
        vehicles.append(
            {
                "id": name,
                "operator": vehicle["operator"],
                "autopilot": vehicle["autopilot"],
                "outcome": outcome.get("state") or "unfinished",
                "reason": outcome.get("reason") or "",
                "finished_s": outcome.get("finished_s"),
                "distance_m": round(distance_m, 3),
                "highest_m": round(highest_m, 3),
                "frames_sent": sent.get(f"gcs:{name}", 0),
                "frames_received": received.get(f"gcs:{name}", 0),
            }
        )
    digests = manifest.get("digests") or {}
    report = record.path / "report.html"
    return {
        "name": manifest["name"],
        "status": record.status,
        "seed": manifest["seed"],
        "simulated_s": record.duration,
        "duration_s": manifest.get("duration_s"),
        "frames": frames,
        "fingerprint": digests.get("fingerprint"),
        "digests": digests,
        "timings": manifest.get("timings") or {},
        "vehicles": vehicles,
        "path": str(record.path),
        "report": str(report) if report.exists() else None,
    }


def _flown(record: RunRecord) -> dict[str, tuple[float, float]]:
    """(distance, greatest height) in metres by vehicle, from one pass over the truth in bounded memory."""
    last: dict[str, np.ndarray[Any, np.dtype[np.float64]]] = {}
    total: dict[str, float] = {}
    highest: dict[str, float] = {}
    for batch in record.batches("truth", ["vehicle", "east_m", "north_m", "up_m"]):
        names = np.asarray(batch.column(0).to_pylist(), dtype=object)
        points = np.column_stack([batch.column(k).to_numpy(zero_copy_only=False) for k in (1, 2, 3)])
        for name in dict.fromkeys(names.tolist()):
            track = points[names == name]
            if name in last:
                track = np.vstack([last[name], track])
            total[name] = total.get(name, 0.0) + float(np.linalg.norm(np.diff(track, axis=0), axis=1).sum())
            highest[name] = max(highest.get(name, 0.0), float(track[:, 2].max()))
            last[name] = track[-1]
    return {name: (total[name], highest[name]) for name in total}


def _frames(record: RunRecord) -> tuple[dict[str, int], dict[str, int], int]:
    """Frames sent up each `gcs` link, those delivered, and the number of all frames."""
    sent: dict[str, int] = {}
    received: dict[str, int] = {}
    frames = 0
    for batch in record.batches("frames", ["link", "direction", "fate"]):
        frames += batch.num_rows
        up = batch.filter(
            pc.and_(pc.starts_with(batch.column(0).cast("string"), "gcs:"), pc.equal(batch.column(1), "rev"))
        )
        for counts, rows in ((sent, up), (received, up.filter(pc.equal(up.column(2), "delivered")))):
            for entry in pc.value_counts(rows.column(0).cast("string")).to_pylist():
                counts[entry["values"]] = counts.get(entry["values"], 0) + entry["counts"]
    return sent, received, frames
