"""Detections of sight: tracks of what returns pulses and is not on the map, for one aircraft.

Returns that lie together are a detection. A detection near the predicted place of a track continues it, any other
begins one. A track counts once detections continued it in `CONFIRMED` of its first scans, and ends when none did for
`LOST_NS`. Position and velocity are filtered by fixed gains (alpha-beta filter: Kalata, IEEE Trans. Aerosp. Electron.
Syst. 20, 1984).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from skyrange.core import elementary_python
from skyrange.core.arrays import Floats
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.optics.ray_index import RayIndex
from skyrange.vehicle.sight.beams import WALL_M, Beams, find_map_distances, find_near_surfaces

TOGETHER_M: Final = 1.0
"""Returns nearer to each other than this are of one thing: twice the width of an Iris."""
LARGEST_M: Final = 3.0
"""What is larger is no small aircraft: a wall, a tree or a crane that is not on the map."""
NEAR_M: Final = 2.0
"""A detection this near to a track's predicted place continues it, plus what it may have moved since."""
FASTEST_MPS: Final = 30.0
"""Closing speed up to which a new track is continued."""
CONFIRMED: Final = 3
LOST_NS: Final[Time] = 700 * NS_PER_MS
MOST: Final = 32
"""Tracks at once."""
MOST_RETURNS: Final = 400
"""Returns of a scan that are taken together: of more, the nearest."""
_ALPHA: Final = 0.5
_BETA: Final = 0.2
"""Gains (assumed)."""


@dataclass(slots=True)
class SeenTrack:
    """Something that sight follows."""

    number: int
    position: Floats
    """(3,)."""
    velocity: Floats
    """(3,)."""
    at_ns: Time
    hits: int = 1

    def predict(self, at_ns: Time) -> Floats:
        """(3,): where it is at a time."""
        return self.position + self.velocity * ((at_ns - self.at_ns) / NS_PER_S)


class SightTracks:
    """The tracks of one aircraft. Deep-copyable."""

    def __init__(self) -> None:
        self._tracks: list[SeenTrack] = []
        self._next = 0

    def update(self, at_ns: Time, beams: Beams, city: RayIndex, known: Floats, known_m: float) -> Sequence[SeenTrack]:
        """Take in a scan; returns the confirmed tracks that it continued.

        `known` (k, 3) are places where radio already has an aircraft; what is within `known_m` of one is left to it.
        """
        self._tracks = [track for track in self._tracks if at_ns - track.at_ns <= LOST_NS]
        continued = []
        for place in self._detect(beams, city, known, known_m):
            track = self._find(at_ns, place)
            if track is None:
                if len(self._tracks) < MOST:
                    self._tracks.append(SeenTrack(self._next, place, np.zeros(3), at_ns))
                    self._next += 1
                continue
            _correct(track, at_ns, place)
            if track.hits >= CONFIRMED:
                continued.append(track)
        return continued

    def _detect(self, beams: Beams, city: RayIndex, known: Floats, known_m: float) -> list[Floats]:
        rows = np.flatnonzero(beams.distance_m > 0.0)
        if not rows.size:
            return []
        distance = beams.distance_m[rows]
        mapped = find_map_distances(city, beams, rows, float(distance.max()) + 2.0 * WALL_M)
        rows = rows[distance < mapped - WALL_M]
        points = beams.origin + beams.direction[rows] * beams.distance_m[rows, None]
        points = points[~find_near_surfaces(city, points, WALL_M)]
        for place in known:
            apart = points - place
            points = points[(apart * apart).sum(axis=1) > known_m * known_m]
        if len(points) > MOST_RETURNS:
            away = points - beams.origin
            points = points[np.argsort((away * away).sum(axis=1), kind="stable")[:MOST_RETURNS]]
        return _join(points)

    def _find(self, at_ns: Time, place: Floats) -> SeenTrack | None:
        """The track that a detection continues: the nearest one within reach that this scan has not continued."""
        best, found = math.inf, None
        for track in self._tracks:
            since_s = (at_ns - track.at_ns) / NS_PER_S
            if since_s <= 0.0:
                continue
            apart = place - track.predict(at_ns)
            away = elementary_python.hypot3(*apart.tolist())
            reach = NEAR_M + (FASTEST_MPS * since_s if track.hits == 1 else 0.0)
            if away <= reach and away < best:
                best, found = away, track
        return found


def _correct(track: SeenTrack, at_ns: Time, place: Floats) -> None:
    since_s = (at_ns - track.at_ns) / NS_PER_S
    expected = track.predict(at_ns)
    if track.hits == 1:
        track.velocity = (place - track.position) / since_s
        track.position = place
    else:
        error = place - expected
        track.position = expected + _ALPHA * error
        track.velocity = track.velocity + _BETA / since_s * error
    track.at_ns = at_ns
    track.hits += 1


def _join(points: Floats) -> list[Floats]:
    """The centres of groups of points, each nearer than `TOGETHER_M` to another one of its group."""
    group = np.full(len(points), -1, dtype=np.int64)
    centres = []
    for first in range(len(points)):
        if group[first] >= 0:
            continue
        group[first] = first
        waiting = [first]
        while waiting:
            apart = points - points[waiting.pop()]
            near = (group < 0) & ((apart * apart).sum(axis=1) <= TOGETHER_M * TOGETHER_M)
            group[near] = first
            waiting += np.flatnonzero(near).tolist()
        members = points[group == first]
        if float((members.max(axis=0) - members.min(axis=0)).max()) <= LARGEST_M:
            centres.append(0.5 * (members.max(axis=0) + members.min(axis=0)))
    return centres
