"""Safety of flights: closest approaches to aircraft and buildings, landings, and mishaps such as collisions.

A ground station knows the end of a mission from heartbeats, one a second, and reports it after two that say so. The
aircraft ended it on the ground. The world notes each touchdown at its tick, whatever autopilot flies, so the time
here has the resolution of the world's quantum (2.5 ms by default), at every level of the record.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S, Time, to_seconds
from skyrange.metrics.time_series import Record, RecordedNote, Track, read_notes, truth_tracks

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

NEAR_M = 10.0
"""Two aircraft nearer than this, centre to centre, have a near miss. This is a modelling choice, about 13 widths of an
Iris. By the 500 ft by 100 ft of a near mid-air collision in crewed aviation, every flight in a street would be one."""
WALLS_M = 30.0
"""Distances to buildings are determined only up to this."""
_MAX_SAMPLES = 300_000  # positions whose distance to buildings is computed: at most a minute of work


class Approaches(NamedTuple):
    """Closest approaches, one row per aircraft, over all ticks at which it was in the air."""

    least_m: Floats
    """(n,) least distance, centre to centre in space; infinite if it was never in the air together with another."""
    nearest: Ints
    """(n,) index of the nearest aircraft; −1 in the same case."""
    tick: Ints
    """(n,) index of the tick; −1 in the same case."""
    near_misses: Ints
    """(n,) number of times that another aircraft came within the limit; one ends when they are farther apart again."""


@compiled
def _closest(enu_m: Floats, aloft: Flags, near_m: float, approaches: Approaches) -> None:
    """Fill in `found`, in which every aircraft is alone at first."""
    ticks, count = aloft.shape
    within = np.zeros((count, count), dtype=np.bool_)
    for t in range(ticks):
        for i in range(count):
            if not aloft[t, i]:
                continue
            for j in range(i + 1, count):
                if not aloft[t, j]:
                    continue
                de = enu_m[t, i, 0] - enu_m[t, j, 0]
                dn = enu_m[t, i, 1] - enu_m[t, j, 1]
                du = enu_m[t, i, 2] - enu_m[t, j, 2]
                away = np.sqrt(de * de + dn * dn + du * du)
                if away < approaches.least_m[i]:
                    approaches.least_m[i], approaches.nearest[i], approaches.tick[i] = away, j, t
                if away < approaches.least_m[j]:
                    approaches.least_m[j], approaches.nearest[j], approaches.tick[j] = away, i, t
                near = away < near_m
                if near and not within[i, j]:
                    approaches.near_misses[i] += 1
                    approaches.near_misses[j] += 1
                within[i, j] = near


def closest_approaches(enu_m: Floats, aloft: Flags, near_m: float = NEAR_M) -> Approaches:
    """Closest approaches of n aircraft over t ticks: `enu_m` (t, n, 3), `aloft` (t, n)."""
    count = aloft.shape[1]
    approaches = Approaches(
        np.full(count, np.inf), np.full(count, -1, np.int64), np.full(count, -1, np.int64), np.zeros(count, np.int64)
    )
    _closest(np.ascontiguousarray(enu_m), np.ascontiguousarray(aloft), near_m, approaches)
    return approaches


def min_building_distance_m(enu_m: Floats, aloft: Flags, city: Sequence[Mapping[str, Any]]) -> Floats:
    """(n,) least distance of each aircraft's centre to a building in metres; infinite beyond `WALLS_M`.

    A building is a prism over its outline from its base to its roof. In long runs with many aircraft only every k-th
    tick is examined.
    """
    count = aloft.shape[1]
    least_m = np.full(count, np.inf)
    rows = [(shapely.Polygon(row["rings"][0], row["rings"][1:]), row) for row in city if row.get("rings")]
    if not rows:
        return least_m
    tree = shapely.STRtree([shape for shape, _ in rows])
    roofs_m = np.array([float(row.get("height_m") or 0.0) for _, row in rows])
    bases_m = np.array([float(row.get("base_m") or 0.0) for _, row in rows])
    stride = max(1, aloft.size // _MAX_SAMPLES)
    for vehicle in range(count):
        places = enu_m[::stride, vehicle][aloft[::stride, vehicle]]
        if not len(places):
            continue
        points = shapely.points(places[:, :2])
        who, where = tree.query(points, predicate="dwithin", distance=WALLS_M)
        if not len(who):
            continue
        beside_m = shapely.distance(points[who], tree.geometries[where])
        up_m = places[who, 2]
        above_m = np.maximum(np.maximum(up_m - roofs_m[where], bases_m[where] - up_m), 0.0)
        nearest_m = float(np.hypot(beside_m, above_m).min())
        least_m[vehicle] = nearest_m if nearest_m <= WALLS_M else np.inf
    return least_m


_TOUCHDOWN: Final = "event.contact"
_TAKEOFF: Final = "event.takeoff"


def find_landings_s(events: Iterable[RecordedNote], outcomes: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """By aircraft whose mission has ended, when it touched down to end it, in s of simulated time, from a run's events
    and outcomes (`state`, `finished_s` by aircraft).

    An aircraft is missing if its ground station reported no end, or if it never touched down.

    The touchdown that ended a mission is the last one before the report of its end. An aircraft that had taken off
    again by then was in the air when the report was made, which somebody may have forged: its next touchdown counts.
    """
    notes_by_aircraft: dict[str, list[RecordedNote]] = {}
    for note in events:
        if note.kind in (_TOUCHDOWN, _TAKEOFF):
            notes_by_aircraft.setdefault(note.about, []).append(note)
    landings_s = {}
    for vehicle, outcome in outcomes.items():
        reported_s = outcome.get("finished_s")
        if reported_s is None:
            continue
        at_ns = _landing_ns(notes_by_aircraft.get(vehicle, []), round(float(reported_s) * NS_PER_S))
        if at_ns is not None:
            landings_s[vehicle] = to_seconds(at_ns)
    return landings_s


def _landing_ns(notes: Iterable[RecordedNote], reported_ns: Time) -> Time | None:
    landed: Time | None = None
    for note in sorted(notes, key=lambda event: event.time_ns):
        if note.time_ns > reported_ns and landed is not None:
            break
        landed = note.time_ns if note.kind == _TOUCHDOWN else None
    return landed


_KINDS = {"event.collision": "collision", "event.crash": "crash", "event.fence_breach": "breach"}
_VIOLENT = frozenset({"collision", "crash"})
_REASONS = frozenset({"gps_glitch", "fence_breached", "avoidance", "terrain_following_failed"})
"""ArduCopter's ModeReasons, besides …_failsafe, that no pilot and no mission caused (libraries/…/ModeReason.h)."""


@dataclass(frozen=True, slots=True)
class Mishap:
    """A mishap. `kind` is collision, crash, breach or failsafe; `enu_m` is the true position of the aircraft."""

    time_ns: int
    vehicle: str
    kind: str
    enu_m: tuple[float, float, float]
    description: str

    @property
    def violent(self) -> bool:
        """Whether it is a collision or a crash."""
        return self.kind in _VIOLENT


def mishap_kind(row: RecordedNote) -> str:
    """The kind of mishap that an event is, "" for none."""
    if row.kind == "event.mode":
        reason = str(row.data.get("reason", ""))
        return "failsafe" if reason.endswith("_failsafe") or reason in _REASONS else ""
    return _KINDS.get(row.kind, "")


def find_mishaps(events: Iterable[RecordedNote], tracks: Mapping[str, Track]) -> list[Mishap]:
    """The mishaps of aircraft whose true position is known, in order of time."""
    mishaps = []
    for row in events:
        kind = mishap_kind(row)
        track = tracks.get(row.about.split(".", 1)[0])
        if not kind or track is None or not len(track):
            continue
        east_m, north_m, up_m = track.at(np.array([row.time_ns]))[0].tolist()
        mishaps.append(Mishap(row.time_ns, row.about, kind, (east_m, north_m, up_m), describe_mishap(row)))
    return sorted(mishaps, key=lambda mark: mark.time_ns)


def distinct_mishaps(rows: Iterable[RecordedNote]) -> list[RecordedNote]:
    """The mishaps among events in order of time; of the two events of a collision, the first."""
    seen: set[tuple[int, str, str]] = set()
    kept = []
    for row in rows:
        kind = mishap_kind(row)
        other = str(row.data.get("with", "")) if kind == "collision" else ""
        if kind and (row.time_ns, other, row.about) not in seen:
            seen.add((row.time_ns, row.about, other))
            kept.append(row)
    return kept


def first_mishaps(events: Iterable[RecordedNote]) -> dict[str, str]:
    """By vehicle, a description of its first collision or crash."""
    descriptions: dict[str, str] = {}
    for row in sorted(events, key=lambda row: row.time_ns):
        if mishap_kind(row) in _VIOLENT:
            descriptions.setdefault(row.about.split(".", 1)[0], f"{_what(row)}, {row.time_ns / NS_PER_S:.1f} s")
    return descriptions


def describe_mishap(row: RecordedNote) -> str:
    """Description of a mishap: aircraft, what happened, speed and energy, time."""
    what = _what(row)
    if row.kind in ("event.collision", "event.crash"):
        if isinstance(speed := row.data.get("speed_mps"), (int, float)):
            what += f" at {speed:.1f} m/s"
        if isinstance(energy := row.data.get("energy_j"), (int, float)):
            what += f" and {energy:.0f} J"
    return f"{row.about}: {what}, {row.time_ns / NS_PER_S:.1f} s"


def _what(row: RecordedNote) -> str:
    if row.kind == "event.mode":
        return f"{row.data.get('mode', '?')} for {str(row.data.get('reason', '')).replace('_', ' ')}"
    if row.kind == "event.collision":
        return f"collision with {row.data.get('with', '?')}"
    return row.kind.partition(".")[2].replace("_", " ")


def drawing_order(mishaps: Iterable[Mishap]) -> list[Mishap]:
    """Drawing order: collisions and crashes last, so that no failsafe covers them."""
    return sorted(mishaps, key=lambda mark: mark.violent)


def read_mishaps(record: Record) -> list[Mishap]:
    """The mishaps of a run."""
    return find_mishaps(read_notes(record, "events"), truth_tracks(record))
