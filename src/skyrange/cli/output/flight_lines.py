"""Lines of a terminal about a flight under way: states of its aircraft, acts, alerts and mishaps, newest last."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from rich.text import Text

from skyrange.cli.output.escaping import escape
from skyrange.core.time import Time, to_seconds
from skyrange.metrics.safety import describe_mishap, distinct_mishaps, mishap_kind
from skyrange.metrics.time_series import RecordedNote
from skyrange.runtime.event_reports import AircraftState, EventReport, ReportedNote, Tally

MAX_ACTS: Final = 3
"""Lines about acts: of those that acted last."""
MAX_EVENTS: Final = 5
"""Lines about mishaps, and as many about other events."""
MAX_GROUPS: Final = 8
"""Lines about flights of a plan that are under way."""
MAX_OBSERVED: Final = 2
"""Groups of which it is shown what happens."""
_MAX_TALLIES: Final = 1_000
"""Kinds of acts and alerts that are told apart; those that were seen last."""

_FRAMES: Final = {
    "send": "sent",
    "inject": "injected",
    "drop": "dropped",
    "delay": "delayed",
    "replace": "replaced",
}
"""What acts do to frames of a link."""
_BEGUN: Final = {"start": "begins", "stop": "ends"}

if TYPE_CHECKING:
    from skyrange.study.execution.executors import GroupEvents

_Key = tuple[str, str, str, str]


@dataclass(slots=True)
class _Line:
    """A line with its simulated time; lines of the same time are in the order in which they came."""

    time_ns: Time
    text: str
    style: str = ""


class FlightLines:
    """What a terminal shows of a flight."""

    def __init__(self, aircraft: int | None) -> None:
        """`aircraft` is how many the scenario has, if that is known."""
        self._aircraft = aircraft
        self._states: dict[str, AircraftState] = {}
        self._tallies: dict[_Key, Tally] = {}
        self._mishaps: list[_Line] = []
        self._events: list[_Line] = []
        self._mishap_count = self._left_out = 0

    def add(self, report: EventReport) -> None:
        """Take what happened since the report before; what is lost stays lost."""
        for vehicle, state in report.states.items():
            if self._states.get(vehicle) is not AircraftState.LOST:
                self._states[vehicle] = state
        for tally in report.tallies:
            key = (tally.author, tally.who, tally.what, tally.about)
            before = self._tallies.pop(key, None)
            if before is not None:
                tally = tally._replace(number=before.number + tally.number, first_ns=before.first_ns)
            self._tallies[key] = tally
        while len(self._tallies) > _MAX_TALLIES:
            self._left_out += self._tallies.pop(next(iter(self._tallies))).number
        mishaps = distinct_mishaps(map(_as_recorded, report.notes))
        self._mishap_count += len(mishaps)
        self._mishaps += [_Line(row.time_ns, _without_time(describe_mishap(row)), "red") for row in mishaps]
        self._events += [line for note in report.notes if (line := _describe_event(note)) is not None]
        del self._mishaps[:-MAX_EVENTS], self._events[:-MAX_EVENTS]
        self._left_out += report.left_out

    def render(self) -> tuple[Text, ...]:
        """The lines as they are now: the aircraft, acts, and what happened, each on one line of the terminal."""
        newest = sorted(self._tallies.values(), key=lambda tally: tally.last_ns)
        acts = [tally for tally in newest if tally.author != "alert"]
        alerts = [_describe_alert(tally) for tally in newest if tally.author == "alert"][-MAX_EVENTS:]
        events = sorted([*self._events, *alerts], key=lambda line: line.time_ns)[-MAX_EVENTS:]
        lines = [
            _Line(0, self._count_states()),
            *map(_describe_acts, acts[-MAX_ACTS:]),
            *sorted([*self._mishaps, *events], key=lambda line: line.time_ns),
        ]
        return tuple(_render_line(line, timed=place > 0) for place, line in enumerate(lines))

    def _count_states(self) -> str:
        counted = Counter(self._states.values())
        words = [f"{counted[state]} {state}" for state in AircraftState]
        earlier = self._mishap_count - len(self._mishaps)
        words += [f"{earlier} earlier mishaps"] if earlier else []
        words += [f"{self._left_out} events not shown"] if self._left_out else []
        return ", ".join(words) if self._aircraft is None else f"{self._aircraft} aircraft: {', '.join(words)}"


def _describe_acts(tally: Tally) -> _Line:
    marks = "" if tally.author == "attack" else f" ({tally.author})"
    style = "magenta" if tally.author == "attack" else ""
    plural = "" if tally.number == 1 else "s"
    if (tally.what, tally.about) == ("send", "rid_up"):
        what = f"broadcast{plural}"
    elif tally.what in _FRAMES:
        what = f"frame{plural} {_FRAMES[tally.what]} on {tally.about}"
    else:
        what = f"act{plural} on {tally.about or tally.what}"  # a sensor, or a part of the body
    since = f"since {to_seconds(tally.first_ns):.1f} s"
    return _Line(tally.last_ns, f"{tally.who}{marks}: {tally.number} {what} {since}", style)


def _describe_alert(tally: Tally) -> _Line:
    since = f" ({tally.number} since {to_seconds(tally.first_ns):.1f} s)" if tally.number > 1 else ""
    return _Line(tally.last_ns, f"alert of {tally.who}: {tally.what}, {tally.about}{since}", "yellow")


def _describe_event(note: ReportedNote) -> _Line | None:
    """The line of an event that is no mishap; `None` for one that is not shown."""
    kind = note.kind.removeprefix("event.")
    author, _, change = kind.partition("_")
    if mishap_kind(_as_recorded(note)) or kind == "mode":
        return None
    if kind == "outcome":
        reason = f": {note.data['reason']}" if note.data.get("reason") else ""
        return _Line(note.time_ns, f"{note.about}: mission {note.data.get('state', '?')}{reason}")
    if change in _BEGUN:
        return _Line(note.time_ns, f"{author} {note.about} {_BEGUN[change]}")
    if kind == "campaign_stage":
        return _Line(note.time_ns, f"{note.about}: stage {note.data.get('stage', '?')}")
    style = "red" if kind == "autopilot_lost" else ""
    return _Line(note.time_ns, f"{note.about}: {kind.replace('_', ' ')}", style)


def _as_recorded(note: ReportedNote) -> RecordedNote:
    return RecordedNote(note.time_ns, note.kind, note.about, "", note.data)


def _without_time(description: str) -> str:
    """A mishap's description without its time, which begins the line."""
    return description.rpartition(", ")[0]


def _render_line(line: _Line, *, timed: bool) -> Text:
    at = f"{to_seconds(line.time_ns):7.1f} s  " if timed else ""
    return Text(at + escape_line(line.text), line.style, no_wrap=True, overflow="ellipsis")


class GroupLines:
    """What a terminal shows of groups of flights under way, and of what happens in those that fly alone."""

    def __init__(self) -> None:
        self._flights: dict[str, tuple[str, FlightLines]] = {}
        """By group: the folder of the flight, and its lines."""

    def render(self, groups: Sequence[tuple[str, int, float]], events: Sequence[GroupEvents]) -> tuple[Text, ...]:
        """The lines: of each group the name of its first flight, how many there are, and the share that is flown; below
        it what happens, if it is one of the first. `events` are those since the last call.
        """
        for group, folder, report in events:
            if self._flights.get(group, ("", None))[0] != folder:
                self._flights[group] = folder, FlightLines(None)
            self._flights[group][1].add(report)
        named = {name for name, _, _ in groups}
        self._flights = {group: flight for group, flight in self._flights.items() if group in named}
        lines: list[Text] = []
        for place, (name, flights, share) in enumerate(groups[:MAX_GROUPS]):
            more = f" and {flights - 1} more" if flights > 1 else ""
            lines.append(_render_line(_Line(0, f"{share:5.0%}  {name}{more}"), timed=False))
            if place < MAX_OBSERVED and name in self._flights:
                shown = self._flights[name][1].render()
                lines += [Text.assemble("       ", line, no_wrap=True, overflow="ellipsis") for line in shown]
        if len(groups) > MAX_GROUPS:
            rest = f"       and {len(groups) - MAX_GROUPS} more at a time"
            lines.append(_render_line(_Line(0, rest), timed=False))
        return tuple(lines)


def escape_line(text: str) -> str:
    """`text` without characters that control a terminal or end a line."""
    return escape(text).replace("\n", "\\n").replace("\t", "\\t")
