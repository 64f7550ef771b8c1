"""Mishaps of a run: collisions, crashes, fence breaches and failsafes, with time, position and description."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from skyrange.core.time import NS_PER_S
from skyrange.metrics.time_series import Record, RecordedNote, Track, read_notes, truth_tracks

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
    found = []
    for row in events:
        kind = mishap_kind(row)
        track = tracks.get(row.about.split(".", 1)[0])
        if not kind or track is None or not len(track):
            continue
        east_m, north_m, up_m = track.at(np.array([row.time_ns]))[0].tolist()
        found.append(Mishap(row.time_ns, row.about, kind, (east_m, north_m, up_m), describe_mishap(row)))
    return sorted(found, key=lambda mark: mark.time_ns)


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
    found: dict[str, str] = {}
    for row in sorted(events, key=lambda row: row.time_ns):
        if mishap_kind(row) in _VIOLENT:
            found.setdefault(row.about.split(".", 1)[0], f"{_what(row)}, {row.time_ns / NS_PER_S:.1f} s")
    return found


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


def drawing_order(found: Iterable[Mishap]) -> list[Mishap]:
    """Drawing order: collisions and crashes last, so that no failsafe covers them."""
    return sorted(found, key=lambda mark: mark.violent)


def read_mishaps(record: Record) -> list[Mishap]:
    """The mishaps of a run."""
    return find_mishaps(read_notes(record, "events"), truth_tracks(record))
