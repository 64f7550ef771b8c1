"""Choice of a detector's threshold: the lowest one whose false alarms on some flights keep to the target rate.

A detector's threshold is chosen on nominal and fault flights of the validation part; nothing of the test part, and no
attack, has an influence on it. The rate that it reaches on other flights is another one, because few hours tell little
of a rate. To compare detectors, each gets another threshold as well, chosen on the nominal flights on which it is
compared: there, and only there, all of them are at the target rate, or as near below it as their scores allow.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.scoring.index import FAULT_STRATUM, NOMINAL_STRATUM, AlertList, StudyIndex
from skyrange.scoring.matching import are_about_intrusions, count_episodes

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
    mine = used[alerts.subjects] & (alerts.times_ns >= subjects.own_from_ns[alerts.subjects])
    mine &= ~are_about_intrusions(index, alerts)
    where, times, scores = alerts.subjects[mine], alerts.times_ns[mine], alerts.scores[mine]

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
