"""Reports of a flight under way: an observer that collects events, alerts and counts of acts for a display.

It never asks for truth and looks at no frame, so it costs a run next to nothing. What a display is too slow to take is
counted, and states of aircraft are never left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any, Final, NamedTuple

from pydantic import TypeAdapter

from skyrange.contracts.alerts import Alert, Scalar
from skyrange.contracts.components import World
from skyrange.contracts.frames import Frame, FrameBlock
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.time import NEVER, Time

MAX_ROWS: Final = 1_000
"""Notes, and kinds of acts and alerts, that are kept until they are taken; more are counted."""
MAX_BYTES: Final = 32_768
"""Of a report from another process, as JSON, beside the states of aircraft."""
MAX_STATES: Final = 300
"""Aircraft whose states are in one report from another process."""
MAX_CHARACTERS: Final = 160
"""Longer texts are cut."""


class AircraftState(StrEnum):
    """What an aircraft does that has taken off once."""

    FLYING = "flying"
    LANDED = "landed"
    LOST = "lost"


_STATES: Final = {
    "event.takeoff": AircraftState.FLYING,
    "event.contact": AircraftState.LANDED,
    "event.landed": AircraftState.LANDED,
    "event.crash": AircraftState.LOST,
    "event.collision": AircraftState.LOST,
    "event.autopilot_lost": AircraftState.LOST,
}
_DEFENCE_ACT: Final = "event.defence_act"
_KEPT: Final = frozenset(
    {
        "event.collision",
        "event.crash",
        "event.autopilot_lost",
        "event.fence_breach",
        "event.mode",
        "event.outcome",
        "event.engine_dead",
        "event.campaign_stage",
        *(f"event.{who}_{what}" for who in ("attack", "fault", "defence", "honest") for what in ("start", "stop")),
    }
)


class ReportedNote(NamedTuple):
    """An event: its simulated time, its kind, what it is about, and its details."""

    time_ns: Time
    kind: str
    about: str
    data: Mapping[str, Scalar]


class Tally(NamedTuple):
    """Acts or alerts alike, counted."""

    author: str
    """attack, fault, harmless or defence; alert for alerts."""
    who: str
    """The id of the attack, fault or defence; the detector."""
    what: str
    """The action, or the kind of alert."""
    about: str
    """The kind of link, or the part of the aircraft; the subject of alerts."""
    number: int
    first_ns: Time
    last_ns: Time


class EventReport(NamedTuple):
    """What happened since the report before."""

    states: Mapping[str, AircraftState]
    """Of the aircraft whose state changed."""
    notes: Sequence[ReportedNote]
    tallies: Sequence[Tally]
    left_out: int
    """Events, acts and alerts that are not in the report."""

    @classmethod
    def read(cls, data: object) -> EventReport:
        """The report that `describe_report` described. Raises `ValueError` for anything else."""
        return _ADAPTER.validate_python(data)


_ADAPTER: Final = TypeAdapter(EventReport)


def describe_report(report: EventReport, *, max_bytes: int = MAX_BYTES) -> Any:
    """A report as plain data, of at most about `max_bytes` as JSON: notes and tallies that do not fit are counted."""
    while len(_ADAPTER.dump_json(report, ensure_ascii=True)) > max_bytes and (report.notes or report.tallies):
        notes, tallies = len(report.notes) // 2, len(report.tallies) // 2
        dropped = len(report.notes) - notes + sum(tally.number for tally in report.tallies[tallies:])
        left_out = report.left_out + dropped
        report = EventReport(report.states, report.notes[:notes], report.tallies[:tallies], left_out)
    return _ADAPTER.dump_python(report, mode="json")


class EventCollector:
    """An `Observer` that keeps what a display shows until it is taken."""

    truth_period_ns: Time = NEVER

    def __init__(self) -> None:
        self._states: dict[str, AircraftState] = {}
        self._notes: list[ReportedNote] = []
        self._tallies: dict[tuple[str, str, str, str], list[Time]] = {}
        self._left_out = 0

    def take(self, max_states: int | None = None) -> EventReport:
        """What happened since the last time; states of more than `max_states` aircraft are in the next reports."""
        tallies = [Tally(*key, *row) for key, row in self._tallies.items()]
        states = list(self._states.items())
        report = EventReport(dict(states[:max_states]), self._notes, tallies, self._left_out)
        later = dict(states[max_states:]) if max_states is not None else {}
        self._states, self._notes, self._tallies, self._left_out = later, [], {}, 0
        return report

    def on_frame(self, frame: Frame) -> None:
        """Frames are not shown."""

    def on_block(self, block: FrameBlock) -> None:
        """Frames are not shown."""

    def on_truth(self, now: Time, world: World) -> None:
        """Positions are not shown."""

    def on_note(self, now: Time, source: str, note: Note) -> None:
        """Keep an event that a display shows."""
        kind = note.kind
        state = _STATES.get(kind)
        if state is not None:
            vehicle = note.about.split(".", 1)[0]
            if self._states.get(vehicle) is not AircraftState.LOST:
                self._states[vehicle] = state
        if kind == _DEFENCE_ACT:
            link = str(note.data.get("frame") or note.data.get("link") or "")
            self._count(now, ("defence", note.about, str(note.data.get("action")), link.partition(":")[0]))
        elif kind in _KEPT:
            if len(self._notes) < MAX_ROWS:
                data = {key: _cut(value) if isinstance(value, str) else value for key, value in note.data.items()}
                self._notes.append(ReportedNote(now, kind, _cut(note.about), data))
            else:
                self._left_out += 1

    def on_label(self, label: Label) -> None:
        """Count an act."""
        author = "fault" if label.fault else "harmless" if label.benign else "attack"
        self._count(label.at_ns, (author, label.attack, label.action, label.frame.link.partition(":")[0]))

    def on_alert(self, now: Time, detector: str, alert: Alert) -> None:
        """Count an alert."""
        self._count(now, ("alert", detector, _cut(alert.kind), _cut(alert.subject)))

    def _count(self, now: Time, key: tuple[str, str, str, str]) -> None:
        row = self._tallies.get(key)
        if row is not None:
            row[0] += 1
            row[2] = now
        elif len(self._tallies) < MAX_ROWS:
            self._tallies[key] = [1, now, now]
        else:
            self._left_out += 1


def _cut(text: str) -> str:
    return text if len(text) <= MAX_CHARACTERS else f"{text[:MAX_CHARACTERS]}…"
