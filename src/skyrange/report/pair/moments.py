"""Moments of what a pair's page tells: when an aircraft was farthest from its twin, nearest to others, and mishaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.figures.subject import Subject
from skyrange.metrics.safety import describe_mishap, distinct_mishaps, min_building_distance_m, mishap_kind
from skyrange.metrics.time_series import RecordedNote, Track, read_notes
from skyrange.record import RunRecord
from skyrange.report import quantities
from skyrange.report.quantities import Linked
from skyrange.report.rendering import render
from skyrange.report.viewer import link_moment

MAX_ROWS: Final = 300
"""Mishaps and alarms in the table."""
MAX_WALL_SAMPLES: Final = 600
"""Positions of an aircraft whose distances to buildings are computed."""
_MEMBERS: Final = 12
"""Aircraft whose nearest wall is located: those that departed farthest."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Moments:
    """When an aircraft's numbers were reached in the attacked run, in seconds; `None` where that is not known."""

    end_s: float | None = None
    """When its mission ended, to which distance and energy are summed."""
    farthest_s: float | None = None
    nearest_s: float | None = None
    wall_s: float | None = None
    collision_s: float | None = None


class MomentFinder:
    """Finds the moments of an attacked run's aircraft, from its tracks, events and city."""

    def __init__(self, attacked: RunRecord, tracks: Mapping[str, Track], events: Sequence[RecordedNote]) -> None:
        self._city = attacked.city
        self._tracks = tracks
        self._collisions: dict[str, float] = {}
        for event in distinct_mishaps(events):
            if mishap_kind(event) in ("collision", "crash"):
                self._collisions.setdefault(event.about, event.time_ns / NS_PER_S)
        self._located = 0

    def find(self, row: Mapping[str, Any], twins: Mapping[str, Track]) -> Moments:
        """The moments of a row of effects; `twins` are the tracks of the arm that it is compared with."""
        name = row["vehicle"]
        track, twin, nearest = self._tracks.get(name), twins.get(name), self._tracks.get(row["nearest"] or "")
        if track is None or not len(track):
            return Moments()
        located = row["departed_s"] is not None and row["min_wall_m"] is not None and self._located < _MEMBERS
        self._located += located
        return Moments(
            end_s=row["finished_s"] if row["landed_s"] is None else row["landed_s"],
            farthest_s=_when_most(track, twin) if row["departed_s"] is not None else None,
            nearest_s=_when_near(track, nearest, row["min_separation_m"]),
            wall_s=self._when_at_wall(track) if located else None,
            collision_s=self._collisions.get(name) if row["collisions"] else None,
        )

    def _when_at_wall(self, track: Track) -> float:
        rows = np.unique(np.linspace(0, len(track) - 1, MAX_WALL_SAMPLES).astype(np.int64))
        places = track.enu_m[rows][None]  # each position counts as an aircraft, so that each has a distance
        away_m = min_building_distance_m(places, np.ones(places.shape[:2], dtype=np.bool_), self._city)
        return float(track.time_ns[rows[int(np.argmin(away_m))]] / NS_PER_S)


def _when_most(track: Track, twin: Track | None) -> float | None:
    """When a track and its twin's are farthest apart."""
    away_m = _distances(track, twin)
    return None if away_m is None else float(track.time_ns[int(np.argmax(away_m))] / NS_PER_S)


def _when_near(track: Track, other: Track | None, least_m: float | None) -> float | None:
    """When two tracks are as far apart as is known of them. Their least distance on the ground may be less."""
    away_m = _distances(track, other)
    if away_m is None or least_m is None:
        return None
    return float(track.time_ns[int(np.argmin(np.abs(away_m - least_m)))] / NS_PER_S)


def _distances(track: Track, other: Track | None) -> Floats | None:
    """(n,) metres between a track's samples and another track while both are known."""
    if other is None or not len(other):
        return None
    inside = (track.time_ns >= other.time_ns[0]) & (track.time_ns <= other.time_ns[-1])
    away_m: Floats = np.where(inside, np.linalg.norm(track.enu_m - other.at(track.time_ns), axis=1), 0.0)
    return away_m


def render_incidents(runs: Mapping[str, RunRecord], subject: Subject) -> Markup | None:
    """Render mishaps and alarms of the arms that the viewer shows, in order of time; `None` without any."""
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    found = [row for arm, run in runs.items() for row in _incidents(arm, run)]
    found.sort(key=lambda row: row["at_s"])
    rows = [
        {
            **row,
            "place": places.get(row["about"]),
            "numbers": [
                Linked(
                    quantities.quantity(row["at_s"], "s", 2),
                    link_moment(row["at_s"], row["about"] if row["about"] in places else "", row["arm"]),
                )
            ],
        }
        for row in found[:MAX_ROWS]
    ]
    return render("pair/incidents.html.jinja", rows=rows, total=len(found)) if found else None


def _incidents(arm: str, run: RunRecord) -> list[dict[str, Any]]:
    mishaps = [
        {
            "at_s": event.time_ns / NS_PER_S,
            "about": event.about.split(".", 1)[0],
            "what": describe_mishap(event),
            "by": "",
            "mishap": True,
        }
        for event in distinct_mishaps(read_notes(run, "events"))
    ]
    alarms = [
        {
            "at_s": row["time_ns"] / NS_PER_S,
            "about": row["subject"],
            "what": row["kind"].replace("_", " "),
            "by": row["detector"],
            "mishap": False,
        }
        for row in run.table("alerts", ["time_ns", "detector", "kind", "subject"]).to_pylist()
    ]
    return [{"arm": arm, **row} for row in (*mishaps, *alarms)]
