"""Alerts of detectors over logs: which ran, what they raised, and how long which vehicle was observed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.core.ids import Port
from skyrange.core.time import Epoch, Time
from skyrange.detect.episodes import subject_of_link
from skyrange.log_detection.airborne import AirborneTimes, Spans
from skyrange.log_detection.detector_choice import Choice, Request, choose, list_ends, list_wanted
from skyrange.log_detection.observed_log import Contents, ObservedLog, Remark, select_places
from skyrange.record.replay import MonitorService
from skyrange.record.write.memory_observer import RaisedAlert

Progress = Callable[[Time, Time], None]
"""Is told the time of the log that was judged, and the time at its end."""
_NO_PLACE: Final = -1
_OF_OPERATORS: Final = ("approval:", "uss:")
"""Links on which no aircraft is observed: their hours are no hours of one."""


@dataclass(frozen=True, slots=True)
class Exposure:
    """How long a subject of alerts was observed."""

    subject: str
    observed_ns: Time
    """From its first frame to its last one."""
    airborne: Spans
    """When it was in the air, as far as its telemetry says so."""


@dataclass(frozen=True, slots=True)
class Findings:
    """What detectors found in one log."""

    log: ObservedLog
    choice: Choice
    alerts: tuple[RaisedAlert, ...]
    """In order of the time at which they were raised, then of the detector's id."""
    exposures: tuple[Exposure, ...]
    frames: int
    first_ns: Time
    last_ns: Time
    remarks: tuple[Remark, ...]

    @property
    def epoch(self) -> Epoch:
        """UTC of time 0."""
        return self.log.epoch


def judge(log: ObservedLog, request: Request, progress: Progress | None = None) -> Findings:
    """Run fresh detectors over a log.

    Raises `InputError` for a request that does not fit, and if no detector is left; `ComponentError` for a detector
    that breaks its contract.
    """
    wanted, unmade = list_wanted(request, log.declared)
    watched = list_ends(log, wanted)
    contents = Contents(log.ends)
    numbers = np.array([log.ends.index(port) for port in watched], dtype=np.int64)
    for table in log.rows(watched):
        contents.add(select_places(table, numbers))
    choice = choose(log, wanted, contents)
    choice = Choice(choice.chosen, (*unmade, *choice.left_out))
    if not choice.chosen:
        hint = "; ".join(f"{one.kind}: {one.reason}" for one in choice.left_out[:5])
        raise InputError.one(str(log.path), "detectors", "none that applies", "frames that a detector judges", hint)
    alerts, airborne = _run(log, choice, watched, progress)
    seen = [found for found in contents.by_end.values() if found.first_ns is not None]
    return Findings(
        log,
        choice,
        alerts,
        _list_exposures(choice, contents, airborne),
        sum(found.frames for found in seen),
        min((found.first_ns for found in seen if found.first_ns is not None), default=0),
        max((found.last_ns for found in seen), default=0),
        tuple(log.remarks),
    )


def _run(
    log: ObservedLog, choice: Choice, watched: Sequence[Port], progress: Progress | None
) -> tuple[tuple[RaisedAlert, ...], AirborneTimes]:
    groups: dict[tuple[Port, ...], list[Any]] = {}
    for one in choice.chosen:
        groups.setdefault(one.ends, []).append(one.placement)
    services = [
        (MonitorService(placements, ends, log.until_ns, past_end=bool(log.side)), _numbers(watched, ends))
        for ends, placements in groups.items()
    ]
    airborne, alerts = AirborneTimes(watched), list[RaisedAlert]()
    for table in log.rows(watched):
        airborne.add(table)
        for service, places in services:
            alerts += service.take(select_places(table, places))
        if progress is not None and table.num_rows:
            progress(int(table.column("at_ns")[-1].as_py()), log.until_ns)
    for service, _ in services:
        alerts += service.finish()
    return tuple(sorted(alerts, key=_raised)), airborne


def _raised(raised: RaisedAlert) -> tuple[Time, str]:
    return raised.time_ns, raised.detector


def _numbers(watched: Sequence[Port], ends: Sequence[Port]) -> NDArray[np.int64]:
    """The place of each of `watched` in `ends`, -1 for none."""
    place = {port: number for number, port in enumerate(ends)}
    return np.array([place.get(port, _NO_PLACE) for port in watched], dtype=np.int64)


def _list_exposures(choice: Choice, contents: Contents, airborne: AirborneTimes) -> tuple[Exposure, ...]:
    """Of each subject that the chosen detectors judge, in order of name."""
    ends = {port for one in choice.chosen for port in one.ends}
    observed: dict[str, tuple[Time, Time]] = {}
    for port in ends:
        found = contents.by_end[port]
        if found.first_ns is None or port.link.startswith(_OF_OPERATORS):
            continue
        subject = subject_of_link(port.link)
        first, last = observed.get(subject, (found.first_ns, found.last_ns))
        observed[subject] = min(first, found.first_ns), max(last, found.last_ns)
    return tuple(
        Exposure(subject, last - first, airborne.spans(subject)) for subject, (first, last) in sorted(observed.items())
    )
