"""Conflict detection: when a moving aircraft enters the cylinder around another, for one aircraft and for many.

Both fly straight on. In the plane |r + v·t| < R is a quadratic in t, upwards |z + w·t| < H is linear; a conflict is
where both hold (a cylinder as in the well-clear volumes of RTCA DO-365 and NASA's DAIDALUS, by distance alone). Who
is inside already and not closing in is no conflict: to go on is the way out, and a formation is its own business.
"""

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
from skyrange.vehicle.avoidance.contract import AvoidanceLimits, Tracks, Vector

_CLOSING_MPS = 0.5
"""Slower than that is no approach but noise: velocities are broadcast in steps of 0.25 m/s."""


@compiled
def entry_s(  # noqa: PLR0917
    rx: float, ry: float, rz: float, vx: float, vy: float, vz: float, radius: float, half_height: float
) -> float:
    """When something at `r` m, moving at `v` m/s, both relative to oneself, enters: seconds, inf for never."""
    a = vx * vx + vy * vy
    b = rx * vx + ry * vy
    c = rx * rx + ry * ry - radius * radius
    begin, end = 0.0, math.inf
    if a > 1e-12:
        root = b * b - a * c
        if root <= 0.0:
            return math.inf
        root = math.sqrt(root)
        begin, end = (-b - root) / a, (-b + root) / a
    elif c >= 0.0:
        return math.inf
    up_begin, up_end = 0.0, math.inf
    if abs(vz) > 1e-9:
        one, two = (-half_height - rz) / vz, (half_height - rz) / vz
        up_begin, up_end = min(one, two), max(one, two)
    elif abs(rz) >= half_height:
        return math.inf
    if min(end, up_end) <= 0.0:
        return math.inf
    enters = max(begin, up_begin)
    if enters >= min(end, up_end):
        return math.inf
    if enters <= 0.0:  # inside: only what still closes in is a conflict
        apart = math.sqrt(rx * rx + ry * ry)
        nearing = b <= -_CLOSING_MPS * apart and b < 0.0
        return 0.0 if nearing or (a <= 1e-12 and rz * vz < 0.0 and abs(vz) >= _CLOSING_MPS) else math.inf
    return enters


@compiled
def _entries(  # noqa: PLR0917
    x: float, y: float, z: float, u: float, v: float, w: float, pos: NDArray[np.float64], vel: NDArray[np.float64],
    radius: float, half_height: float, standing_mps: float, moving_s: float, standing_s: float,
    out: NDArray[np.float64],
) -> None:  # fmt: skip
    for k in range(pos.shape[0]):
        rz = 0.0 if math.isnan(pos[k, 2]) else pos[k, 2] - z
        at = entry_s(pos[k, 0] - x, pos[k, 1] - y, rz, vel[k, 0] - u, vel[k, 1] - v, vel[k, 2] - w, radius, half_height)
        speed2 = vel[k, 0] * vel[k, 0] + vel[k, 1] * vel[k, 1]
        horizon = standing_s if speed2 < standing_mps * standing_mps else moving_s
        out[k] = at if at <= horizon else math.inf


def find_conflicts(
    pos: Vector,
    vel: Vector,
    tracks: Tracks,
    limits: AvoidanceLimits,
    *,
    scale: float = 1.0,
    moving_s: float | None = None,
    standing_s: float | None = None,
) -> tuple[int, ...]:
    """Rows of the tracks in conflict with flying on at `vel`, the soonest first; the cylinder `scale`d.

    `moving_s` and `standing_s` are the look-aheads for what moves and what stands, where they differ from the limits'.
    """
    out = np.empty(len(tracks.pos_enu_m))
    _entries(
        *pos, *vel, tracks.pos_enu_m, tracks.vel_enu_mps, limits.protected_m * scale, limits.protected_up_m * scale,
        limits.standing_mps, limits.look_ahead_s if moving_s is None else moving_s,
        limits.look_ahead_s if standing_s is None else standing_s, out,
    )  # fmt: skip
    conflicting: list[int] = np.flatnonzero(np.isfinite(out)).tolist()
    return tuple(sorted(conflicting, key=lambda row: (float(out[row]), row)))


def velocity_towards(start: Vector, goal: Vector, speed_mps: float) -> tuple[Vector, float]:
    """The velocity (m/s) that leads straight from one place to another, and how long it takes (s)."""
    away = (goal[0] - start[0], goal[1] - start[1], goal[2] - start[2])
    length = math.sqrt(away[0] * away[0] + away[1] * away[1] + away[2] * away[2])
    if length < 1e-6:
        return (0.0, 0.0, 0.0), 0.0
    scale = speed_mps / length
    return (away[0] * scale, away[1] * scale, away[2] * scale), length / speed_mps


_GROUND = int(Status.GROUND)

Floats = NDArray[np.float64]


@compiled
def _screen(  # noqa: PLR0917
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
    in_conflict = np.zeros(len(asks), dtype=np.bool_)
    _screen(tracks.rows, tracks.used, tracks.stale_ns, now, places, velocities, limits, asks, in_conflict)
    return in_conflict
