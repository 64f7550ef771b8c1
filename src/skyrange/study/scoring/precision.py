"""Precision at a prevalence: of the alarms, the share that is about an attack, where attacks are as rare as stated.

Of a study it would be without meaning, because half of its runs are attacked. The base rate decides (Axelsson, "The
base-rate fallacy and the difficulty of intrusion detection", ACM TISSEC 3 (2000) 186-205).
"""

from __future__ import annotations

import math

from skyrange.study.scoring.intervals import Limits, proportion_interval, rate_interval


def precision_at(prevalence_per_h: float, recall: float, false_per_h: float) -> float | None:
    """Bayes' rule with rates: detections / (detections + false alarms), where attacks come at `prevalence_per_h`.

    Rates are per aircraft-hour; each attack counts for one alarm if it is detected. None if there are no alarms at all.
    """
    true_per_h = prevalence_per_h * recall
    if math.isinf(false_per_h):
        return 0.0
    return true_per_h / (true_per_h + false_per_h) if true_per_h + false_per_h > 0.0 else None


def precision_interval(
    prevalence_per_h: float, hits: int, trials: int, count: int, hours: float, confidence: float
) -> Limits:
    """Limits of the precision: recall and false-alarm rate each at the confidence (1 + confidence) / 2.

    By Bonferroni's inequality both intervals hold together with at least `confidence`. Precision increases with recall
    and decreases with the rate, so its limits are at their opposite ends. Raises InputError if SciPy is missing.
    """
    each = (1.0 + confidence) / 2.0
    recall, rate = proportion_interval(hits, trials, each), rate_interval(count, hours, each)
    low = precision_at(prevalence_per_h, recall[0], rate[1])
    high = precision_at(prevalence_per_h, recall[1], rate[0])
    return low or 0.0, 1.0 if high is None else high
