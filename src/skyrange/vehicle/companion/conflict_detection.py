"""Conflict detection for many aircraft: all tracks of all of them, in one kernel."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.f3411 import Status
from skyrange.contracts.frames import Ints
from skyrange.core.compiled import compiled
from skyrange.core.time import Time
from skyrange.remoteid.tracks import TrackTable
from skyrange.vehicle.avoidance.conflicts import entry_s

_GROUND = int(Status.GROUND)

Floats = NDArray[np.float64]


@compiled
def _screen(
    rows: Any, used: Ints, stale_ns: int, now: int, places: Floats, velocities: Floats, limits: Floats,
    asks: NDArray[np.bool_], found: NDArray[np.bool_],
) -> None:  # fmt: skip
    for r in range(rows.shape[0]):
        if not asks[r]:
            continue
        for k in range(used[r]):
            row = rows[r, k]
            if (
                row.heard_ns < 0
                or row.is_impossible != 0
                or row.is_ignored != 0
                or row.located_ns < 0
                or now - row.located_ns > stale_ns
            ):
                continue
            if math.isnan(row.east) or row.status == _GROUND:
                continue
            age = max(now - row.located_ns, 0) / 1e9
            ve, vn, vu = row.ve, row.vn, row.vu
            ve = 0.0 if math.isnan(ve) else ve
            vn = 0.0 if math.isnan(vn) else vn
            vu = 0.0 if math.isnan(vu) else vu
            up = 0.0 if math.isnan(row.up) else row.up + vu * age - places[r, 2]
            at = entry_s(
                row.east + ve * age - places[r, 0], row.north + vn * age - places[r, 1], up,
                ve - velocities[r, 0], vn - velocities[r, 1], vu - velocities[r, 2], limits[r, 0], limits[r, 1],
            )  # fmt: skip
            if at <= limits[r, 2]:
                found[r] = True
                break


def detect_conflicts(
    tracks: TrackTable, now: Time, places: Floats, velocities: Floats, limits: Floats, asks: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """(n,) which of the aircraft in `asks` are on a conflict course with an airborne track, as in
    `avoidance.conflicts`.

    `places` and `velocities` (n, 3) in the local frame; `limits` (n, 3): protected radius and half height in m, and
    look-ahead in s.
    """
    found = np.zeros(len(asks), dtype=np.bool_)
    _screen(tracks.rows, tracks.used, tracks.stale_ns, now, places, velocities, limits, asks, found)
    return found
