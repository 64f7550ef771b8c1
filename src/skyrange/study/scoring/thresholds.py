"""Choice of a detector's threshold: the lowest one whose false alarms on validation flights keep to the target rate.

Only nominal and fault flights of the validation part are read; nothing of the test part, and no attack, has an
influence on it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.study.scoring.index import FAULT_STRATUM, NOMINAL_STRATUM, AlertList, StudyIndex
from skyrange.study.scoring.matching import count_episodes

NS_PER_H = 3600 * NS_PER_S


class ThresholdChoice(NamedTuple):
    """A threshold, and what it was chosen on."""

    threshold: float
    """Alerts with a score above it are alarms; −∞ if all are."""
    episodes: int
    """False alarms on the validation flights at this threshold."""
    hours: float
    """Aircraft-hours of the validation flights."""


def choose_threshold(index: StudyIndex, alerts: AlertList, target_per_h: float, episode_ns: int) -> ThresholdChoice:
    """The lowest threshold with at most `target_per_h` episodes of false alarms per aircraft-hour of validation.

    It is −∞ or the score of an alert. Raises InputError if the validation part has no nominal or fault flights.
    """
    subjects = index.subjects
    benign = (subjects.strata == NOMINAL_STRATUM) | (subjects.strata == FAULT_STRATUM)
    used = (subjects.splits == "validation") & benign
    hours = float(subjects.duration_ns[used].sum()) / NS_PER_H
    if hours <= 0.0:
        expected = "airborne time of nominal or fault flights, from which thresholds are chosen"
        raise InputError.one("tables of the study", "flights, split validation", "none", expected)
    mine = used[alerts.subjects]
    where, times, scores = alerts.subjects[mine], alerts.times_ns[mine], alerts.scores[mine]

    def episodes_above(threshold: float) -> int:
        above = scores > threshold
        return int(count_episodes(where[above], times[above], episode_ns, len(used)).sum())

    allowed = target_per_h * hours * (1.0 + 1e-12)
    candidates = np.concatenate(([-math.inf], np.unique(scores)))
    low, high = 0, candidates.shape[0] - 1  # above the highest score there are no alarms
    while low < high:
        middle = (low + high) // 2
        if episodes_above(float(candidates[middle])) <= allowed:
            high = middle
        else:
            low = middle + 1
    threshold = float(candidates[low])
    return ThresholdChoice(threshold, episodes_above(threshold), hours)
