"""Landings that ended missions, from the touchdowns that the world recorded.

A ground station knows the end of a mission from heartbeats, one a second, and reports it after two that say so. The
aircraft ended it on the ground. The world notes each touchdown at its tick, whatever autopilot flies, so the time
here has the resolution of the world's quantum (2.5 ms by default), at every level of the record.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from skyrange.core.time import NS_PER_S, Time, to_seconds
from skyrange.metrics.time_series import RecordedNote

_TOUCHDOWN: Final = "event.contact"
_TAKEOFF: Final = "event.takeoff"


def find_landings_s(events: Iterable[RecordedNote], outcomes: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """By aircraft whose mission has ended, when it touched down to end it, in s of simulated time, from a run's events
    and outcomes (`state`, `finished_s` by aircraft).

    An aircraft is missing if its ground station reported no end, or if it never touched down.

    The touchdown that ended a mission is the last one before the report of its end. An aircraft that had taken off
    again by then was in the air when the report was made, which somebody may have forged: its next touchdown counts.
    """
    own: dict[str, list[RecordedNote]] = {}
    for note in events:
        if note.kind in (_TOUCHDOWN, _TAKEOFF):
            own.setdefault(note.about, []).append(note)
    found = {}
    for vehicle, outcome in outcomes.items():
        reported_s = outcome.get("finished_s")
        if reported_s is None:
            continue
        at_ns = _landing_ns(own.get(vehicle, []), round(float(reported_s) * NS_PER_S))
        if at_ns is not None:
            found[vehicle] = to_seconds(at_ns)
    return found


def _landing_ns(notes: Iterable[RecordedNote], reported_ns: Time) -> Time | None:
    landed: Time | None = None
    for note in sorted(notes, key=lambda one: one.time_ns):
        if note.time_ns > reported_ns and landed is not None:
            break
        landed = note.time_ns if note.kind == _TOUCHDOWN else None
    return landed
