"""Mishaps of a run: collisions, crashes, breaches and failsafes, as marks for timeline and map."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from skyrange.core.time import NS_PER_S
from skyrange.study.series import Happening, Record, Track, happenings, truth_tracks

_KINDS = {"event.collision": "collision", "event.crash": "crash", "event.fence_breach": "breach"}
_VIOLENT = frozenset({"collision", "crash"})
_REASONS = frozenset({"gps_glitch", "fence_breached", "avoidance", "terrain_following_failed"})
"""ArduCopter's ModeReasons besides those in …_failsafe that no pilot or mission gave (libraries/…/ModeReason.h)."""


@dataclass(frozen=True, slots=True)
class Mark:
    """`kind` is collision, crash, breach or failsafe; `enu_m` where the aircraft truly was."""

    time_ns: int
    vehicle: str
    kind: str
    enu_m: tuple[float, float, float]
    words: str

    @property
    def violent(self) -> bool:
        """Whether it is a collision or a crash."""
        return self.kind in _VIOLENT


def alarming(row: Happening) -> str:
    """The kind of mark that an event is worth, "" for none."""
    if row.kind == "event.mode":
        reason = str(row.data.get("reason", ""))
        return "failsafe" if reason.endswith("_failsafe") or reason in _REASONS else ""
    return _KINDS.get(row.kind, "")


def marks(events: Iterable[Happening], tracks: Mapping[str, Track]) -> list[Mark]:
    """A mark for every alarming event about an aircraft whose place is known, in time order."""
    found = []
    for row in events:
        kind = alarming(row)
        track = tracks.get(row.about.split(".", 1)[0])
        if not kind or track is None or not len(track):
            continue
        east_m, north_m, up_m = track.at(np.array([row.time_ns]))[0].tolist()
        found.append(Mark(row.time_ns, row.about, kind, (east_m, north_m, up_m), said(row)))
    return sorted(found, key=lambda mark: mark.time_ns)


def told_once(rows: Iterable[Happening]) -> list[Happening]:
    """The alarming ones among events in time order; of the two that a collision makes, the first."""
    seen: set[tuple[int, str, str]] = set()
    kept = []
    for row in rows:
        kind = alarming(row)
        other = str(row.data.get("with", "")) if kind == "collision" else ""
        if kind and (row.time_ns, other, row.about) not in seen:
            seen.add((row.time_ns, row.about, other))
            kept.append(row)
    return kept


def undoing(events: Iterable[Happening]) -> dict[str, str]:
    """By vehicle, in words, the first collision or crash that befell it: why its ground station saw it stop."""
    found: dict[str, str] = {}
    for row in sorted(events, key=lambda row: row.time_ns):
        if alarming(row) in _VIOLENT:
            found.setdefault(row.about.split(".", 1)[0], f"{_what(row)}, {row.time_ns / NS_PER_S:.1f} s")
    return found


def said(row: Happening) -> str:
    """An alarming event in words: about whom, what, how fast and with what energy, when."""
    what = _what(row)
    if row.kind in ("event.collision", "event.crash"):
        if isinstance(speed := row.data.get("speed_mps"), (int, float)):
            what += f" at {speed:.1f} m/s"
        if isinstance(energy := row.data.get("energy_j"), (int, float)):
            what += f" and {energy:.0f} J"
    return f"{row.about}: {what}, {row.time_ns / NS_PER_S:.1f} s"


def _what(row: Happening) -> str:
    if row.kind == "event.mode":
        return f"{row.data.get('mode', '?')} for {str(row.data.get('reason', '')).replace('_', ' ')}"
    if row.kind == "event.collision":
        return f"collision with {row.data.get('with', '?')}"
    return row.kind.partition(".")[2].replace("_", " ")


def by_weight(found: Iterable[Mark]) -> list[Mark]:
    """In the order to draw them, so that a failsafe after a crash does not cover the crash."""
    return sorted(found, key=lambda mark: mark.violent)


def marks_of(record: Record) -> list[Mark]:
    """The marks of a run."""
    return marks(happenings(record, "events"), truth_tracks(record))
