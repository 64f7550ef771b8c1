"""Matching of alarms and attacks: episodes of alarms, which attacks were detected, and the choice of thresholds.

- An alarm is an alert with a score above the threshold. Alarms inside and outside of windows form episodes apart.
- An attack is detected by the first alarm about a subject that it affects, within [observable, stop + grace]. Later
  alarms of the window add nothing, and no other instant counts as detected with it (no point adjustment).
- An alarm about a subject of a harmless intrusion, within its window, is about that: neither a detection nor false.
- All other alarms are false, except for those between the beginning of acting and `observable`: they are neither.
- False alarms are counted in episodes, those before a run differs from the nominal one of its block in that run alone.

An episode begins with an alert and takes up all alerts of the same subject that are less than `episode_ns` later than
its *beginning*; the next alert begins another one. If the distance to the *previous* alert counted instead, an alarm
that never ends would be a single false alarm, and one more alert could join two episodes and so lower their number.
Counted from the beginning, the number of episodes is the least number of intervals [t, t + episode_ns) that cover all
alerts, so no alert that is added lowers it.

A detector's threshold is chosen on nominal and fault flights of the validation part; nothing of the test part, and no
attack, has an influence on it. The rate that it reaches on other flights is another one, because few hours tell little
of a rate. To compare detectors, each gets another threshold as well, chosen on the nominal flights on which it is
compared: there, and only there, all of them are at the target rate, or as near below it as their scores allow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.core.errors import InputError
from skyrange.core.time import NEVER, NS_PER_S
from skyrange.scoring.index import FAULT_STRATUM, NOMINAL_STRATUM, AlertList, StudyIndex, Windows


@compiled
def find_episodes(subjects: NDArray[np.int64], times: NDArray[np.int64], episode_ns: int) -> NDArray[np.bool_]:
    """Which alerts begin an episode, shape (n,); `subjects` and `times` (ns), shape (n,), sorted by subject, then time.

    `episode_ns` is positive.
    """
    begins = np.zeros(times.shape[0], dtype=np.bool_)
    subject, begin = np.int64(-1), np.int64(0)
    for i in range(times.shape[0]):
        if subjects[i] != subject or times[i] - begin >= episode_ns:
            subject, begin = subjects[i], times[i]
            begins[i] = True
    return begins


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
    matched, _ = _match_windows(bounds, alerts.times_ns, index.intrusion_windows, len(index.intrusions.runs))
    return matched


def _match_windows(
    bounds: NDArray[np.int64], times: NDArray[np.int64], windows: Windows, count: int
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Which alarms are in a window, shape (alarms,), and the earliest that detects each of `count` acts, or `NEVER`."""
    detected = np.full(count, NEVER, dtype=np.int64)
    acting = _mark_windows(bounds, times, windows, detected)
    return acting, detected


def count_episodes(
    subjects: NDArray[np.int64], times_ns: NDArray[np.int64], episode_ns: int, count: int
) -> NDArray[np.int64]:
    """Episodes of each of `count` subjects, shape (count,); alerts sorted by subject, then time."""
    begins = find_episodes(subjects, times_ns, episode_ns)
    return np.bincount(subjects[begins], minlength=count).astype(np.int64)


@compiled
def _mark_windows(
    bounds: NDArray[np.int64], times: NDArray[np.int64], windows: Windows, detected: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Which alarms are in a window, shape (alarms,); fills in `detected`, shape (attacks,), with the earliest one."""
    acting = np.zeros(times.shape[0], dtype=np.bool_)
    for row in range(windows.attacks.shape[0]):
        attack, subject = windows.attacks[row], windows.subjects[row]
        first, last = bounds[subject], bounds[subject + 1]
        for i in range(first + np.searchsorted(times[first:last], windows.act_ns[row]), last):
            if times[i] > windows.end_ns[row]:
                break
            acting[i] = True
            if times[i] >= windows.begin_ns[row] and times[i] < detected[attack]:
                detected[attack] = times[i]
    return acting


NS_PER_H = 3600 * NS_PER_S


class ThresholdChoice(NamedTuple):
    """A threshold, and what it was chosen on."""

    threshold: float
    """Alerts with a score above it are alarms; −∞ if all are."""
    episodes: NDArray[np.int64]
    """False alarms about each subject that was used, at this threshold, shape (subjects,)."""
    used: NDArray[np.bool_]
    """The subjects that it was chosen on, shape (subjects,)."""


def choose_threshold(index: StudyIndex, alerts: AlertList, target_per_h: float, episode_ns: int) -> ThresholdChoice:
    """The lowest threshold with at most `target_per_h` episodes of false alarms per aircraft-hour of validation.

    It is −∞ or the score of an alert. Raises InputError if the validation part has no nominal or fault flights.
    """
    subjects = index.subjects
    benign = (subjects.strata == NOMINAL_STRATUM) | (subjects.strata == FAULT_STRATUM)
    used = (subjects.splits == "validation") & benign
    if not subjects.exposure_ns[used].sum():
        expected = "airborne time of nominal or fault flights, from which thresholds are chosen"
        hint = "Blocks that share a seed are in one split: fly more seeds, or each point with seeds of its own."
        raise InputError.one("tables of the study", "flights, split validation", "none", expected, hint)
    return lower_threshold(index, alerts, used, target_per_h, episode_ns)


def lower_threshold(
    index: StudyIndex, alerts: AlertList, used: NDArray[np.bool_], target_per_h: float, episode_ns: int
) -> ThresholdChoice:
    """The lowest threshold with at most `target_per_h` episodes of alarms per aircraft-hour of the `used` subjects."""
    subjects = index.subjects
    counted = used[alerts.subjects] & (alerts.times_ns >= subjects.own_from_ns[alerts.subjects])
    counted &= ~are_about_intrusions(index, alerts)
    where, times, scores = alerts.subjects[counted], alerts.times_ns[counted], alerts.scores[counted]

    def episodes_above(threshold: float) -> NDArray[np.int64]:
        above = scores > threshold
        return count_episodes(where[above], times[above], episode_ns, len(used))

    allowed = target_per_h * float(subjects.exposure_ns[used].sum()) / NS_PER_H * (1.0 + 1e-12)
    candidates = np.concatenate(([-math.inf], np.unique(scores)))
    low, high = 0, candidates.shape[0] - 1  # above the highest score there are no alarms
    while low < high:
        middle = (low + high) // 2
        if int(episodes_above(float(candidates[middle])).sum()) <= allowed:
            high = middle
        else:
            low = middle + 1
    threshold = float(candidates[low])
    return ThresholdChoice(threshold, episodes_above(threshold), used)
