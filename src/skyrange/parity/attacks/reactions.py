"""Reactions of an aircraft to an attack, by rules that are the same for all kinds of autopilot.

A flight is compared with its nominal twin, the flight of the same autopilot without the attack. The rules use what
every autopilot shows: truth, changes of mode, STATUSTEXT, acknowledgements, and the outcome at the ground station.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import hypot
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import decode, dialect, message_name
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId, endpoint, link_name
from skyrange.core.time import NS_PER_S
from skyrange.metrics.paths import AIRBORNE_M
from skyrange.metrics.time_series import Track, read_notes, truth_tracks, vehicles
from skyrange.record import RunRecord

Floats = NDArray[np.float64]

REACTIONS: Final = ("crashes", "fails safe", "stays down", "lands", "obeys", "departs", "rejects", "ignores")
"""All reactions. The first that applies is the aircraft's:

- crashes: it hits the ground or another aircraft, or its autopilot ends, and its twin does not
- fails safe: its autopilot announces a failsafe or a breach of its fence, which its twin does not, or at another time
- stays down: it does not take off, and its twin does
- lands: it is down at a place where its twin is not
- obeys: hostile frames were sent to it, and it changes its mode or its track
- departs: the same, but no hostile frame was sent to it: it misses frames, or gets them late, or its station is misled
- rejects: its flight is that of its twin, and it answers with more refusals
- ignores: its flight is that of its twin, and so are its refusals
"""
NO_EFFECT: Final = frozenset(("ignores", "rejects"))
"""Reactions that do not change a flight."""
DEPARTED_M: Final = 2.0
"""A track changes if it is farther than this from that of the twin at the same time; ArduCopter's WPNAV_RADIUS."""
PLACE_M: Final = 5.0
"""Two landings closer than this are in one place."""
TIME_S: Final = 2.0
"""Events at most this far apart are one event; reactions at most this far apart are simultaneous. Two autopilots reach
an item up to 1 s apart, and a station repeats its orders once per second."""
FAR_M: Final = 5.0
FAR_SHARE: Final = 0.2
"""Two departures are equally large if they differ by at most `FAR_M`, which is flown in 1 s, or by this share of the
larger one."""
_ANNOUNCED: Final = ("failsafe", "breached", "ekf variance")
_ENDED: Final = ("cleared", "prearm", "arm:")
_LOST: Final = frozenset(("event.crash", "event.collision", "event.autopilot_lost"))
_ORDERS: Final = frozenset(("replace", "inject", "send"))
_FINE: Final = frozenset((dialect.MAV_RESULT_ACCEPTED, dialect.MAV_RESULT_IN_PROGRESS))

Happened = tuple[tuple[float, str], ...]
"""Times in s and what happened."""


@dataclass(frozen=True, slots=True)
class Flight:
    """What one run shows of one aircraft. Times are in s since the scenario's start.

    `lost` are crashes, collisions and the end of an autopilot; `failsafes` the texts that announce one; `modes` the
    changes of mode; `refusals` the negative acknowledgements that it sent; `landings` the times of landing.
    """

    outcome: str = "unfinished"
    lost: Happened = ()
    failsafes: Happened = ()
    modes: Happened = ()
    refusals: Happened = ()
    takeoff_s: float | None = None
    landings: tuple[float, ...] = ()
    time_s: Floats = field(default_factory=lambda: np.zeros(0))
    """(n,) times of the track."""
    enu_m: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    """(n, 3) true positions."""

    @property
    def landed_at(self) -> tuple[float, float] | None:
        """East and north in m at the last landing; `None` without one."""
        if not self.landings or not len(self.time_s):
            return None
        return self._place(self.landings[-1])

    def _place(self, at_s: float) -> tuple[float, float]:
        east, north = (float(np.interp(at_s, self.time_s, self.enu_m[:, axis])) for axis in (0, 1))
        return east, north


@dataclass(frozen=True, slots=True)
class Reaction:
    """Reaction of one aircraft to an attack.

    `reaction` is one of `REACTIONS`. `at_s` is in s after the attack's start, `None` if nothing happened; of a landing
    elsewhere, it is when the aircraft leaves the track of its twin. `signs` are
    what shows it, in order of time after the attack's start. `departed_m` is the largest distance from the twin.
    """

    reaction: str
    at_s: float | None
    signs: Happened
    departed_m: float
    outcome: str
    nominal_outcome: str
    undecided: str = ""
    """Why equal flights do not show that the attack was ignored, or ""."""

    @property
    def severity(self) -> int:
        """Place among `REACTIONS`: 0 is the most severe one."""
        return REACTIONS.index(self.reaction)


def react(attacked: Flight, nominal: Flight, start_s: float, *, ordered: bool) -> Reaction:
    """The reaction of an aircraft to an attack that starts at `start_s`.

    `ordered` says whether hostile frames were sent to the aircraft.
    """
    lost = _new(attacked.lost, nominal.lost)
    safe = _new(_announced(attacked), _announced(nominal))
    kept = [(at_s, f"no {text}") for at_s, text in _absent(_announced(nominal), _announced(attacked))]
    modes = [(at_s, mode) for at_s, mode in _new(attacked.modes, nominal.modes) if at_s >= start_s]
    refusals = _refusals(attacked, nominal, start_s)
    departed_m, departed_s = _departure(attacked, nominal)
    changed = sorted([*modes, *([] if departed_s is None else [(departed_s, f"leaves its track by {DEPARTED_M:g} m")])])
    rows_by_reaction = {
        "crashes": lost,
        "fails safe": safe,
        "stays down": _stays_down(attacked, nominal),
        "lands": _lands(attacked, nominal),
        "obeys": changed if ordered else [],
        "departs": changed,
        "rejects": refusals,
    }
    reaction = next((name for name, rows in rows_by_reaction.items() if rows), "ignores")
    rows_of = (changed if reaction == "lands" else None) or rows_by_reaction.get(reaction)
    rows = [*lost, *safe, *kept, *modes, *(row for name in ("stays down", "lands") for row in rows_by_reaction[name])]
    if reaction in ("obeys", "departs") and departed_s is not None and not modes:
        rows += [row for row in changed if row[0] == departed_s]
    if reaction not in ("crashes", "fails safe"):
        rows += refusals[:1]
    if attacked.outcome != nominal.outcome:
        rows.append((float("inf"), f"mission {attacked.outcome}, not {nominal.outcome}"))
    return Reaction(
        reaction=reaction,
        at_s=rows_of[0][0] - start_s if rows_of else None,
        signs=tuple((at_s - start_s, text) for at_s, text in sorted(rows)),
        departed_m=departed_m,
        outcome=attacked.outcome,
        nominal_outcome=nominal.outcome,
        undecided=_shows_nothing(attacked, nominal) if reaction in NO_EFFECT else "",
    )


def alike(first: Reaction, second: Reaction) -> bool:
    """Whether two reactions are the same, at the same time after the attack's start, and lead equally far.

    Those that are undecided are not.
    """
    if first.undecided or second.undecided:
        return False
    if first.reaction != second.reaction:
        return False
    if first.at_s is not None and second.at_s is not None and abs(first.at_s - second.at_s) > TIME_S:
        return False
    far = max(FAR_M, FAR_SHARE * max(first.departed_m, second.departed_m))
    return abs(first.departed_m - second.departed_m) <= far


def _shows_nothing(attacked: Flight, nominal: Flight) -> str:
    """Why two flights that are equal would be so under any attack, or ""."""
    if attacked.takeoff_s is None and nominal.takeoff_s is None:
        return "neither the attacked nor the nominal flight takes off"
    if attacked.lost and nominal.lost:
        return "the attacked and the nominal flight both crash"
    return ""


def _announced(flight: Flight) -> Happened:
    """Failsafes without the details of their texts: numbers differ between two flights."""
    return tuple((at_s, text.partition(" - ")[0]) for at_s, text in flight.failsafes)


def _new(happened: Happened, other: Happened) -> list[tuple[float, str]]:
    """What happened in one flight, and in the other not within `TIME_S` of it."""
    return [
        (at_s, what)
        for at_s, what in happened
        if not any(it == what and abs(at_s - when_s) <= TIME_S for when_s, it in other)
    ]


def _absent(happened: Happened, other: Happened) -> list[tuple[float, str]]:
    """What never happened in the other flight."""
    return [(at_s, what) for at_s, what in happened if what not in {it for _, it in other}]


def _refusals(attacked: Flight, nominal: Flight, start_s: float) -> list[tuple[float, str]]:
    """The refusals since the attack's start, if there are more than without the attack."""
    attacked_refusals, nominal_refusals = (
        [row for row in flight.refusals if row[0] >= start_s] for flight in (attacked, nominal)
    )
    return attacked_refusals if len(attacked_refusals) > len(nominal_refusals) else []


def _stays_down(attacked: Flight, nominal: Flight) -> list[tuple[float, str]]:
    if attacked.takeoff_s is None and nominal.takeoff_s is not None:
        return [(nominal.takeoff_s, "no take-off")]
    return []


def _lands(attacked: Flight, nominal: Flight) -> list[tuple[float, str]]:
    place = attacked.landed_at
    if place is None or not len(nominal.enu_m):
        return []
    other = nominal.landed_at or (float(nominal.enu_m[-1, 0]), float(nominal.enu_m[-1, 1]))
    away_m = hypot(place[0] - other[0], place[1] - other[1])
    return [(attacked.landings[-1], f"lands {away_m:.0f} m away")] if away_m > PLACE_M else []


def _departure(attacked: Flight, nominal: Flight) -> tuple[float, float | None]:
    """Largest distance from the twin at equal times in m, and when it first exceeded `DEPARTED_M`."""
    both = min(len(attacked.time_s), len(nominal.time_s))
    if not both:
        return 0.0, None
    away_m = np.sqrt(((attacked.enu_m[:both] - nominal.enu_m[:both]) ** 2).sum(axis=1))
    beyond = np.flatnonzero(away_m > DEPARTED_M)
    return float(away_m.max()), float(attacked.time_s[beyond[0]]) if len(beyond) else None


def read_flights(record: RunRecord) -> dict[str, Flight]:
    """The flight of every aircraft of a run, in the manifest's order."""
    notes = read_notes(record, "events")
    tracks = truth_tracks(record)
    texts, refusals = _sent(record)
    flights = {}
    for vehicle in vehicles(record):
        vehicle_notes = [(note.time_ns / NS_PER_S, note) for note in notes if note.about == vehicle.id]
        times_s, places_m = _sampled(tracks[vehicle.id])

        def down(at_s: float, times_s: Floats = times_s, places_m: Floats = places_m) -> bool:
            """ArduPilot reports a landing wherever it is disarmed."""
            return bool(len(times_s)) and float(np.interp(at_s, times_s, places_m[:, 2]) - places_m[0, 2]) < AIRBORNE_M

        flights[vehicle.id] = Flight(
            outcome=str(record.outcomes.get(vehicle.id, {}).get("state") or "unfinished"),
            lost=tuple(
                (at_s, note.kind.removeprefix("event.").replace("_", " "))
                for at_s, note in vehicle_notes
                if note.kind in _LOST
            ),
            failsafes=tuple(texts[vehicle.id]),
            modes=tuple((at_s, str(note.data["mode"])) for at_s, note in vehicle_notes if note.kind == "event.mode"),
            refusals=tuple(refusals[vehicle.id]),
            takeoff_s=next((at_s for at_s, note in vehicle_notes if note.kind == "event.takeoff"), None),
            landings=tuple(at_s for at_s, note in vehicle_notes if note.kind == "event.landed" and down(at_s)),
            time_s=times_s,
            enu_m=places_m,
        )
    return flights


def ordered_vehicles(record: RunRecord) -> set[str]:
    """Aircraft to which frames that do harm were sent, on a link of their own, by the labels of a run."""
    owners = {vehicle.id for vehicle in vehicles(record)}
    ordered = set()
    for row in record.table("labels").to_pylist():
        if row["action"] not in _ORDERS or row["benign"]:
            continue
        frame = FrameId.parse(row["frame"])
        kind, _, owner = frame.link.partition(":")
        if kind in ("gcs", "autopilot") and frame.direction == "fwd" and owner in owners:
            ordered.add(owner)
    return ordered


def _sampled(track: Track) -> tuple[Floats, Floats]:
    """The track from time 0 on: only engines that boot have truth before it."""
    here = track.since(0)
    return here.time_ns / NS_PER_S, here.enu_m


def _sent(record: RunRecord) -> tuple[dict[str, list[tuple[float, str]]], dict[str, list[tuple[float, str]]]]:
    """The announcements of failsafes and the refusals that each autopilot sent."""
    owners = {link_name("autopilot", vehicle.id): vehicle.id for vehicle in vehicles(record)}
    texts: dict[str, list[tuple[float, str]]] = {owner: [] for owner in owners.values()}
    refusals: dict[str, list[tuple[float, str]]] = {owner: [] for owner in owners.values()}
    for frame in record.frames_with_payloads():
        owner = owners.get(frame.link)
        if owner is None or frame.sender != endpoint(owner, "autopilot"):
            continue
        name, at_s = message_name(frame.payload), frame.sent_ns / NS_PER_S
        if name == "STATUSTEXT":
            texts[owner] += [(at_s, text) for text in _failsafe_texts(frame.payload)]
        elif name in ("COMMAND_ACK", "MISSION_ACK"):
            refusals[owner] += [(at_s, text) for text in _refused(frame.payload)]
    return texts, refusals


def _failsafe_texts(payload: bytes) -> Iterator[str]:
    text = str(decode(payload).text)
    lower = text.lower()
    if any(word in lower for word in _ANNOUNCED) and not any(word in lower for word in _ENDED):
        yield text


def _refused(payload: bytes) -> Iterator[str]:
    try:
        message = decode(payload)
    except DecodeError:
        return
    if message.get_type() == "COMMAND_ACK" and message.result not in _FINE:
        yield f"{_name('MAV_CMD', message.command)} {_name('MAV_RESULT', message.result).lower()}"
    elif message.get_type() == "MISSION_ACK" and message.type != dialect.MAV_MISSION_ACCEPTED:
        yield f"mission {_name('MAV_MISSION_RESULT', message.type).lower()}"


def _name(enum: str, number: int) -> str:
    prefix = {"MAV_MISSION_RESULT": "MAV_MISSION_"}.get(enum, f"{enum}_")
    entry = dialect.enums[enum].get(number)
    return str(entry.name).removeprefix(prefix) if entry is not None else str(number)


def most_severe(reactions: Sequence[Reaction]) -> Reaction:
    """The most severe of several aircraft's reactions; of equal ones, the first."""
    return min(reactions, key=lambda reaction: reaction.severity)
