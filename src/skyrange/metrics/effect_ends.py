"""Ends of the effects of attacks, read from a run's own record: no twin is needed.

An attack whose last act has taken effect may still be in force: an altered mission is flown on. Each kind declares what
ends its effect (`AttackPlugin.persists`; the manifest of a run has it):

- `acts`: its last act.
- `upload`: the ground station has begun another upload after the last act, and the autopilot has stored it.
- `mode`: the ground station has commanded another mode after the last act, and the autopilot has changed to it.
- `flight`: the end of the flight.

The end of the flight ends each of them. It is the flight in which the last act falls, or the next one if the aircraft
was disarmed by then; it ends when the aircraft is disarmed, crashes or its autopilot is lost. If no flight follows,
nothing was altered that flew, and the effect ends with the last act. A flight that does not end lasts to the end of the
run.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from skyrange.attack.contract import Persistence
from skyrange.core.time import Time, from_seconds
from skyrange.metrics.time_series import RecordedNote, read_notes
from skyrange.record.manifest import fleet_of
from skyrange.record.read.run import RunRecord

_BEGINS: Final = frozenset({"event.armed", "event.takeoff"})
_ENDS: Final = frozenset({"event.disarmed", "event.crash", "event.autopilot_lost"})
_REWRITES: Final[Mapping[str, tuple[frozenset[str], frozenset[str]]]] = {
    "upload": (
        frozenset({"decision.connected"}),
        frozenset({"event.mission", "event.fence", "event.rally"}),
    ),
    "mode": (
        frozenset(
            f"decision.{what}" for what in ("streams_set", "departing", "plan_done", "gave_up", "reroute_requested")
        ),
        frozenset({"event.mode"}),
    ),
}
"""By persistence: the decisions of a ground station that write it anew, and the events that say it is written."""


def read_persistence(record: RunRecord) -> dict[str, Persistence]:
    """By id of an attack: what ends its effect, `acts` where its kind does not say."""
    return {row["id"]: row.get("persists") or "acts" for row in record.manifest.get("attacks") or ()}


def read_effect_ends_ns(record: RunRecord, last_ns: Mapping[tuple[str, str], Time]) -> dict[tuple[str, str], Time]:
    """By attack and aircraft, as in `last_ns`, the times of the last acts: when the effect of each ends.

    An empty aircraft stands for the whole run.
    """
    persistence = read_persistence(record)
    notes: dict[str, list[RecordedNote]] = {vehicle: [] for vehicle in fleet_of(record.manifest, str(record.path))}
    if any(persistence.get(attack, "acts") != "acts" for attack, _ in last_ns):
        for note in (*read_notes(record, "decisions"), *read_notes(record, "events")):
            if note.about in notes:
                notes[note.about].append(note)
    for vehicle_notes in notes.values():
        vehicle_notes.sort(
            key=lambda note: note.time_ns
        )  # of one instant, decisions come first: they are of what was before
    end_ns = from_seconds(record.duration)
    return {
        (attack, vehicle): find_effect_end_ns(
            persistence.get(attack, "acts"), at_ns, [vehicle] if vehicle else list(notes), notes, end_ns
        )
        for (attack, vehicle), at_ns in last_ns.items()
    }


def find_effect_end_ns(
    persists: Persistence,
    last_ns: Time,
    vehicles: Iterable[str],
    notes: Mapping[str, Sequence[RecordedNote]],
    run_end_ns: Time,
) -> Time:
    """When the effect of an attack ends whose last act was at `last_ns`: the latest end over `vehicles`.

    `vehicles` are those that it acted on, or all of its run; `notes` has decisions and events about each, in order of
    time. Not before `last_ns`.
    """
    if persists == "acts":
        return last_ns
    ends = [_end_ns(persists, last_ns, notes.get(vehicle, ()), run_end_ns) for vehicle in vehicles]
    return max(ends, default=last_ns)


def _end_ns(persists: Persistence, last_ns: Time, notes: Sequence[RecordedNote], run_end_ns: Time) -> Time:
    begins, written = _REWRITES.get(persists, (frozenset(), frozenset()))
    flying = rewriting = False
    for note in notes:
        if note.kind in _BEGINS:
            flying = True
        if note.time_ns <= last_ns:
            flying = flying and note.kind not in _ENDS
            continue
        rewriting = rewriting or note.kind in begins
        if (rewriting and note.kind in written) or (flying and note.kind in _ENDS):
            return note.time_ns
    return max(run_end_ns, last_ns) if flying else last_ns
