"""Rates of false alarms over benign logs, per hour, with exact limits and the least rate that the hours can support.

An alarm is an episode of alerts, as in `scoring.matching`: it begins with an alert and takes up all alerts about the
same subject that are less than `episode_s` later than its beginning. In a benign log each one is false.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from skyrange.core.time import NS_PER_S, Time, from_seconds
from skyrange.detect.episodes import subject_of_link
from skyrange.log_detection.airborne import Spans, airborne_ns
from skyrange.log_detection.judging import Findings
from skyrange.record.write.memory_observer import RaisedAlert
from skyrange.scoring.matching import NS_PER_H, count_episodes
from skyrange.scoring.result_file import ScoreSettings
from skyrange.statistics.exact_intervals import Limits, lowest_claimable_rate, rate_interval

SETTINGS: Final = ScoreSettings()
"""The length of an episode and the confidence are those of scores."""
SHOWN_LIMITS: Final = f"{SETTINGS.confidence:.0%}"


class FalseAlarmRate(NamedTuple):
    """False alarms in some hours. Of vehicles these are vehicle-hours, of receivers of Remote ID receiver-hours."""

    episodes: int
    hours: float
    per_h: float | None
    """None without hours."""
    limits: Limits
    """Garwood's, exact if alarms are independent; the upper one may be infinite."""
    lowest_per_h: float
    """No rate below it can be claimed from these hours, even without an alarm; infinite without hours."""


class DetectorRates(NamedTuple):
    """The false alarms of a detector over all logs in which it ran."""

    detector: str
    kind: str
    logs: int
    alerts: int
    whole: FalseAlarmRate
    """From the first frame to the last one, time on the ground included."""
    airborne: FalseAlarmRate
    """In the air alone."""


def measure_false_alarms(findings: Sequence[Findings]) -> list[DetectorRates]:
    """The rates of each detector, in order of id. Raises `InputError` if SciPy is missing."""
    names = sorted({(one.id, one.kind) for found in findings for one in found.choice.chosen})
    return [_measure(id_, kind, findings) for id_, kind in names]


def warn_of_copies(findings: Sequence[Findings]) -> list[str]:
    """A warning for each log that may be a copy of another one, whose hours and alarms would count twice."""
    first: dict[tuple[int, int, int], Path] = {}
    warnings = []
    for found in findings:
        begin = found.log.epoch.unix_ns + found.first_ns
        key = begin // NS_PER_S, (found.last_ns - found.first_ns) // NS_PER_S, found.frames
        other = first.setdefault(key, found.log.path)
        if other is not found.log.path:
            told = "have the same times and number of frames; if they are one, it counts twice"
            warnings.append(f"{other} and {found.log.path} {told}")
    return warnings


def _measure(id_: str, kind: str, findings: Sequence[Findings]) -> DetectorRates:
    counts, hours_ns = [0, 0], [0, 0]
    logs = alerts = 0
    for found in findings:
        ends = [port for one in found.choice.chosen if (one.id, one.kind) == (id_, kind) for port in one.ends]
        if not ends:
            continue
        logs += 1
        judged = {subject_of_link(port.link) for port in ends}
        spans = {one.subject: one.airborne for one in found.exposures if one.subject in judged}
        hours_ns[0] += sum(one.observed_ns for one in found.exposures if one.subject in judged)
        hours_ns[1] += sum(airborne_ns(flown) for flown in spans.values())
        raised = [one for one in found.alerts if one.detector == id_]
        alerts += len(raised)
        counts[0] += count_alarms(raised)
        counts[1] += count_alarms(one for one in raised if _was_airborne(one, spans))
    return DetectorRates(id_, kind, logs, alerts, *(_rate(*pair) for pair in zip(counts, hours_ns, strict=True)))


def count_alarms(raised: Iterable[RaisedAlert]) -> int:
    """The episodes of some alerts of one detector over one log."""
    rows = sorted((one.alert.subject, one.alert.at) for one in raised)
    if not rows:
        return 0
    names = sorted({subject for subject, _ in rows})
    subjects = np.array([names.index(subject) for subject, _ in rows], dtype=np.int64)
    times = np.array([at for _, at in rows], dtype=np.int64)
    return int(count_episodes(subjects, times, from_seconds(SETTINGS.episode_s), len(names)).sum())


def _was_airborne(raised: RaisedAlert, spans: dict[str, Spans]) -> bool:
    """Whether the subject of an alert, or any vehicle if it is none of them, was in the air."""
    flights = [spans[raised.alert.subject]] if raised.alert.subject in spans else list(spans.values())
    return any(begin <= raised.alert.at <= end for flown in flights for begin, end in flown)


def _rate(count: int, observed_ns: Time) -> FalseAlarmRate:
    hours = observed_ns / NS_PER_H
    limits = rate_interval(count, hours, SETTINGS.confidence)
    lowest = lowest_claimable_rate(hours, SETTINGS.confidence)
    return FalseAlarmRate(count, hours, count / hours if hours > 0.0 else None, limits, lowest)
