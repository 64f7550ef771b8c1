"""The kernel over all aircraft finds the conflicts that each one's own look finds."""

from __future__ import annotations

import numpy as np
import pytest

from skyrange.codec import f3411
from skyrange.core.time import NS_PER_S
from skyrange.remoteid.tracks import TrackTable
from skyrange.vehicle.avoidance.conflicts import detect_conflicts, find_conflicts
from skyrange.vehicle.avoidance.contract import AvoidanceLimits, Tracks
from tests.unit.test_remoteid_tracks import ORIGIN, hear, place, who

LIMITS = AvoidanceLimits()


@pytest.mark.parametrize("seed", range(3))
def test_the_screen_agrees_with_the_decision(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 60
    table = TrackTable(count, ORIGIN)
    for receiver in range(count):
        for number in range(int(rng.integers(0, 9))):
            (east, north), up, speed = rng.uniform(-80, 80, 2), rng.uniform(25, 55), rng.uniform(0, 15)
            status = f3411.Status.GROUND if rng.random() < 0.1 else f3411.Status.AIRBORNE
            said = place(
                east, north, None if rng.random() < 0.1 else up, status=status,
                speed_mps=None if rng.random() < 0.1 else speed, track_deg=float(rng.integers(0, 360)),
            )  # fmt: skip
            if rng.random() < 0.1:
                said = said._replace(lat_deg=95.0)
            hear(table, float(rng.uniform(0, 3)), who(f"A{number}"), said, receiver=receiver)
    places = rng.uniform((-20, -20, 25), (20, 20, 55), (count, 3))
    velocities = rng.uniform((-10, -10, -1), (10, 10, 1), (count, 3))
    asks = rng.random(count) < 0.9
    limits = np.tile((LIMITS.protected_m, LIMITS.protected_up_m, LIMITS.look_ahead_s), (count, 1))
    now = 4 * NS_PER_S
    found = detect_conflicts(table, now, places, velocities, limits, asks)
    own = []
    for row in range(count):
        seen = table.snapshot(row, now, grounded=False)
        tracks = Tracks(seen.pos_enu_m, seen.vel_enu_mps)
        rows = find_conflicts(tuple(places[row].tolist()), tuple(velocities[row].tolist()), tracks, LIMITS)
        own.append(bool(rows) and bool(asks[row]))
    assert found.tolist() == own
    assert 8 < sum(own) < count
    alone = detect_conflicts(table, now, places, velocities, limits, asks & (np.arange(count) == own.index(True)))
    assert np.flatnonzero(alone).tolist() == [own.index(True)]
