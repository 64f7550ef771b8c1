"""Precision at a prevalence: of the alarms, the share that is about an attack, where attacks are as rare as stated.

Of a study it would be without meaning, because half of its runs are attacked. The base rate decides (Axelsson, "The
base-rate fallacy and the difficulty of intrusion detection", ACM TISSEC 3 (2000) 186-205).
"""

from __future__ import annotations

import math

from skyrange.statistics.exact_intervals import Limits


def precision_at(prevalence_per_h: float, recall: float, false_per_h: float) -> float | None:
    """Bayes' rule with rates: detections / (detections + false alarms), where attacks come at `prevalence_per_h`.

    Rates are per aircraft-hour; each attack counts for one alarm if it is detected. None if there are no alarms at all.
    """
    true_per_h = prevalence_per_h * recall
    if math.isinf(false_per_h):
        return 0.0
    return true_per_h / (true_per_h + false_per_h) if true_per_h + false_per_h > 0.0 else None


def precision_limits(prevalence_per_h: float, recall: Limits, false_per_h: Limits) -> Limits:
    """Limits of the precision from those of recall and false-alarm rate.

    If each of these holds with the confidence (1 + c) / 2, both hold together with at least c, by Bonferroni's
    inequality. Precision increases with recall and decreases with the rate, so its limits are at their opposite ends.
    """
    low = precision_at(prevalence_per_h, recall[0], false_per_h[1])
    high = precision_at(prevalence_per_h, recall[1], false_per_h[0])
    return low or 0.0, 1.0 if high is None else high
