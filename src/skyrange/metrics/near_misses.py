"""Near misses as notes: when two aircraft in the air come nearer to each other than a limit."""

from __future__ import annotations

import numpy as np

from skyrange.metrics.aircraft_measures import everyone, read_ticks
from skyrange.metrics.separation import NEAR_M
from skyrange.metrics.time_series import RecordedNote, vehicles
from skyrange.record.read.run import RunRecord


def near_misses(record: RunRecord, near_m: float = NEAR_M) -> list[RecordedNote]:
    """A note of kind `near_miss` for each aircraft and each time that another comes nearer than `near_m`.

    Counted as in `separation.closest_approaches`: again only after they were farther apart. In order of time.
    """
    ticks, names = read_ticks(record), [vehicle.id for vehicle in vehicles(record)]
    names += ticks.others
    enu_m, aloft = everyone(ticks)
    found = []
    for k in range(len(names)):
        away_m = np.sqrt(((enu_m[:, k + 1 :] - enu_m[:, k : k + 1]) ** 2).sum(axis=2))
        near = (away_m < near_m) & aloft[:, k + 1 :] & aloft[:, k : k + 1]
        begins = near & ~np.vstack([np.zeros((1, near.shape[1]), dtype=np.bool_), near[:-1]])
        for tick, other in np.argwhere(begins).tolist():
            pair, time_ns = (names[k], names[k + 1 + other]), int(ticks.time_ns[tick])
            data = {"distance_m": round(float(away_m[tick, other]), 3)}
            for mine, theirs in (pair, pair[::-1]):
                found.append(RecordedNote(time_ns, "near_miss", mine, "world", {"with": theirs, **data}))
    return sorted(found, key=lambda note: note.time_ns)
