"""Limits of a proportion whose trials come in clusters, which are alike within a cluster.

Korn & Graubard, "Confidence intervals for proportions with small expected number of positive counts estimated from
survey data", Survey Methodology 24 (1998) 193-201: Clopper-Pearson's interval with the number of independent trials
that has the same variance, less what the few clusters cost. Where all trials agree each cluster counts as one trial.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np

from skyrange.study.inference.exact_intervals import Limits, load_special
from skyrange.study.inference.student import t_quantile


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
    quantile = 0.5 + confidence / 2.0
    independent = float(count)
    if 0.0 < share < 1.0:
        residuals = top - share * trials
        variance = count / (count - 1.0) * float((residuals**2).sum()) / total**2
        independent = min(total, share * (1.0 - share) / variance) if variance > 0.0 else total
        independent *= (t_quantile(quantile, int(total) - 1) / t_quantile(quantile, count - 1)) ** 2
    special, tail = load_special(), 1.0 - quantile
    found = share * independent
    low = 0.0 if share == 0.0 else float(special.betaincinv(found, independent - found + 1.0, tail))
    high = 1.0 if share == 1.0 else float(special.betaincinv(found + 1.0, independent - found, 1.0 - tail))
    return min(low, share), max(high, share)
