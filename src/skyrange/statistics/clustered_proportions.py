"""Limits of a proportion whose trials come in clusters, which are alike within a cluster.

Korn & Graubard, "Confidence intervals for proportions with small expected number of positive counts estimated from
survey data", Survey Methodology 24 (1998) 193-201: Clopper-Pearson's interval with the number of independent trials
that has the same variance, less what the few clusters cost. Where all trials agree each cluster counts as one trial.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from skyrange.statistics.exact_intervals import Limits, load_special, proportion_interval


def clustered_proportion_interval(
    hits: Sequence[bool], clusters: Sequence[Hashable], confidence: float
) -> Limits | None:
    """The limits of the share of `hits`, (n,), whose clusters are named in `clusters`, (n,); `None` with one cluster.

    Raises `InputError` if SciPy is missing.
    """
    codes = {name: number for number, name in enumerate(dict.fromkeys(clusters))}
    count = len(codes)
    if count < 2:
        return None
    places = [codes[name] for name in clusters]
    top = np.bincount(places, np.array(hits, dtype=np.float64))
    trials = np.bincount(places).astype(np.float64)
    share, total = float(top.sum() / trials.sum()), float(trials.sum())
    independent = float(count)
    if 0.0 < share < 1.0:
        residuals = top - share * trials
        variance = count / (count - 1.0) * float((residuals**2).sum()) / total**2
        independent = min(total, share * (1.0 - share) / variance) if variance > 0.0 else total
        every, few = load_special().stdtrit([total - 1.0, count - 1.0], 0.5 + confidence / 2.0).tolist()
        independent *= (every / few) ** 2
    low, high = proportion_interval(share * independent, independent, confidence)
    return min(low, share), max(high, share)
