"""Matching of alarms and attacks: which attacks were detected, when, and which alarms were false.

- An alarm is an alert with a score above the threshold. Alarms inside and outside of windows form episodes apart.
- An attack is detected by the first alarm about a subject that it affects, within [observable, stop + grace]. Later
  alarms of the window add nothing, and no other instant counts as detected with it (no point adjustment).
- An alarm about a subject of a harmless intrusion, within its window, is about that: neither a detection nor false.
- All other alarms are false, except for those between the beginning of acting and `observable`: they are neither.
- False alarms are counted in episodes, those before a run differs from the nominal one of its block in that run alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.core.time import NEVER
from skyrange.scoring.episodes import find_episodes
from skyrange.scoring.index import AlertList, StudyIndex, Windows


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the alarms of a detector came to."""

    detected_ns: NDArray[np.int64]
    """When each attack was detected, shape (attacks,); `NEVER` if it was missed."""
    false_alarms: NDArray[np.int64]
    """Number of episodes of false alarms about each subject, shape (subjects,)."""
    intrusions: NDArray[np.bool_]
    """Whether there was an alarm about each harmless intrusion, shape (intrusions,)."""


def match_alarms(index: StudyIndex, alerts: AlertList, threshold: float, episode_ns: int) -> Outcome:
    """What the alerts with a score above `threshold` come to."""
    above = alerts.scores > threshold
    subjects, times = alerts.subjects[above], alerts.times_ns[above]
    count = len(index.subjects.runs)
    bounds = np.searchsorted(subjects, np.arange(count + 1))
    acting, detected = _match_windows(bounds, times, index.windows, len(index.attacks.runs))
    intruding, reported = _match_windows(bounds, times, index.intrusion_windows, len(index.intrusions.runs))
    false = ~acting & ~intruding & (times >= index.subjects.own_from_ns[subjects])
    return Outcome(detected, count_episodes(subjects[false], times[false], episode_ns, count), reported != NEVER)


def are_about_intrusions(index: StudyIndex, alerts: AlertList) -> NDArray[np.bool_]:
    """Which alerts are in the window of a harmless intrusion, shape (alerts,)."""
    bounds = np.searchsorted(alerts.subjects, np.arange(len(index.subjects.runs) + 1))
    found, _ = _match_windows(bounds, alerts.times_ns, index.intrusion_windows, len(index.intrusions.runs))
    return found


def _match_windows(
    bounds: NDArray[np.int64], times: NDArray[np.int64], windows: Windows, count: int
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Which alarms are in a window, shape (alarms,), and the earliest that detects each of `count` acts, or `NEVER`."""
    detected = np.full(count, NEVER, dtype=np.int64)
    acting = _mark_windows(
        bounds, times, windows.attacks, windows.subjects, windows.act_ns, windows.begin_ns, windows.end_ns, detected
    )
    return acting, detected


def count_episodes(
    subjects: NDArray[np.int64], times_ns: NDArray[np.int64], episode_ns: int, count: int
) -> NDArray[np.int64]:
    """Episodes of each of `count` subjects, shape (count,); alerts sorted by subject, then time."""
    begins = find_episodes(subjects, times_ns, episode_ns)
    return np.bincount(subjects[begins], minlength=count).astype(np.int64)


@compiled
def _mark_windows(
    bounds: NDArray[np.int64],
    times: NDArray[np.int64],
    attacks: NDArray[np.int64],
    subjects: NDArray[np.int64],
    acts: NDArray[np.int64],
    begins: NDArray[np.int64],
    ends: NDArray[np.int64],
    detected: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Which alarms are in a window, shape (alarms,); fills in `detected`, shape (attacks,), with the earliest one."""
    acting = np.zeros(times.shape[0], dtype=np.bool_)
    for row in range(attacks.shape[0]):
        subject = subjects[row]
        first, last = bounds[subject], bounds[subject + 1]
        for i in range(first + np.searchsorted(times[first:last], acts[row]), last):
            if times[i] > ends[row]:
                break
            acting[i] = True
            if times[i] >= begins[row] and times[i] < detected[attacks[row]]:
                detected[attacks[row]] = times[i]
    return acting
