"""Measured coverage of the intervals and limits of studies, on samples with a known truth.

`python -m tools.docs.measure_coverage` draws `REPLICATES` samples for each cell, by a seed that is the cell's own, and
writes `docs/reference/coverage.md`. It takes about three minutes of processor time.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from skyrange.core.ids import hash64
from skyrange.scoring.detector_measures import judge_claim
from skyrange.scoring.result_file import ScoreSettings
from skyrange.statistics.clusters import clustered_proportion_interval
from skyrange.statistics.exact_intervals import proportion_interval, rate_bound
from skyrange.statistics.means import estimate_mean
from tests.validation.inference_samples import DISTRIBUTIONS, RATES

ROOT: Final = Path(__file__).parents[2]
PAGE: Final = ROOT / "docs" / "reference" / "coverage.md"
REPLICATES: Final = 2_000
COUNTS: Final = (3, 5, 10, 19, 20, 40, 100)
CLUSTERS: Final = (5, 10, 20, 60)
INTRODUCTION: Final = f"""\
# Measured coverage

How often the 95 % intervals of skyrange contain the truth, from {REPLICATES:,} samples with a known truth for each
number. `make reproduce WHAT=coverage` (`python -m tools.docs.measure_coverage`) computes this page.
"""
MEANS: Final = """\
## Means over seeds

The share of the samples whose interval contains the true mean ([means](../explanation/scoring.md#means-over-seeds) of
studies, pairs and comparisons), and in parentheses the share that has an interval, if that is not every one. **Bold**:
less than 93 %, too narrow for such data. Few samples do not show that. If data are skewed and seeds few, read the
single flights too.
"""
CLAIMS: Final = """\
## Claims of a false-alarm rate

The true rate is the target, 1 per hour, over 60 hours. The share of the samples with a false claim of at most 1 per
hour, which should be at most 5 %: by [the claim of
scores](../explanation/scoring.md#the-least-rate-that-can-be-claimed), and by Garwood's limit alone.
"""
PROPORTIONS: Final = """\
## Recall of attacks that are alike within a cluster

Six attacks in each cluster, a recall of 0.7. The share of the samples whose limits contain it: of `clustered` limits,
and of `exact` ones, which assume that attacks are independent.
"""


def main() -> None:
    """Measure, and write the page."""
    parts = [INTRODUCTION, MEANS, "\n".join(_tabulate_means()), CLAIMS, "\n".join(_tabulate_claims())]
    parts += [PROPORTIONS, "\n".join(_tabulate_proportions())]
    PAGE.write_text("\n".join(part if part.endswith("\n") else f"{part}\n" for part in parts), encoding="utf-8")


def measure_mean(name: str, count: int) -> str:
    """A cell of the table of means."""
    chance, drawn = _chance(f"mean {name} {count}"), DISTRIBUTIONS[name]
    intervals = [
        estimate_mean(drawn.draw(chance, count).tolist(), yes_or_no=name == "yes or no") for _ in range(REPLICATES)
    ]
    limits = [
        (interval.low, interval.high)
        for interval in intervals
        if interval is not None and interval.low is not None and interval.high is not None
    ]
    shown = len(limits) / REPLICATES
    if shown < 0.005:
        return "none"
    covered = float(np.mean([low <= drawn.mean <= high for low, high in limits]))
    text = f"{100 * covered:.0f} %"
    text = f"**{text}**" if covered < 0.93 else text
    return text if shown > 0.995 else f"{text} ({100 * shown:.0f} %)"


def measure_claim(rates: str, clusters: int) -> tuple[str, str]:
    """The cells of the table of claims: false claims by the claim, and by Garwood's limit alone."""
    chance, hours = _chance(f"claim {rates} {clusters}"), np.full(clusters, 60.0 / clusters)
    settings = ScoreSettings(target_per_h=1.0)
    claimed, poisson = 0, 0
    for _ in range(REPLICATES):
        counts = chance.poisson(RATES[rates](chance, clusters) * hours).astype(np.float64)
        claimed += judge_claim(counts, hours, settings).verdict == "claimed"
        poisson += rate_bound(int(counts.sum()), 60.0, 0.95) <= 1.0
    return f"{100 * claimed / REPLICATES:.1f} %", f"{100 * poisson / REPLICATES:.0f} %"


def measure_proportion(clusters: int, alike: float) -> tuple[str, str]:
    """The cells of the table of proportions: coverage of clustered limits, and of exact ones."""
    chance, recall = _chance(f"proportion {clusters} {alike}"), 0.7
    names = np.repeat(np.arange(clusters), 6).tolist()
    covered = np.zeros(2)
    for _ in range(REPLICATES):
        of_cluster = np.full(clusters, recall)
        if alike:
            size = (1.0 - alike) / alike
            of_cluster = chance.beta(recall * size, (1.0 - recall) * size, clusters)
        hits = (chance.random((clusters, 6)) < of_cluster[:, np.newaxis]).ravel()
        clustered = clustered_proportion_interval(hits.tolist(), names, 0.95) or (0.0, 1.0)
        exact = proportion_interval(int(hits.sum()), hits.size, 0.95)
        covered += [low <= recall <= high for low, high in (clustered, exact)]
    return f"{100 * covered[0] / REPLICATES:.0f} %", f"{100 * covered[1] / REPLICATES:.0f} %"


def _tabulate_means() -> Iterator[str]:
    yield from _head("samples", *map(str, COUNTS))
    for name in DISTRIBUTIONS:
        yield _row(name, *(measure_mean(name, count) for count in COUNTS))


def _tabulate_claims() -> Iterator[str]:
    yield from _head("rates of clusters", *(f"{count} clusters" for count in CLUSTERS), "Garwood alone")
    for name in RATES:
        cells = [measure_claim(name, count) for count in CLUSTERS]
        yield _row(name, *(one for one, _ in cells), ", ".join(two for _, two in cells))


def _tabulate_proportions() -> Iterator[str]:
    yield from _head("correlation within a cluster", *(f"{count} clusters" for count in CLUSTERS), "exact")
    for alike in (0.0, 0.3, 0.6):
        cells = [measure_proportion(count, alike) for count in CLUSTERS]
        yield _row(f"{alike:g}", *(one for one, _ in cells), ", ".join(two for _, two in cells))


def _head(*cells: str) -> Iterator[str]:
    yield _row(*cells)
    yield _row(*["---"] * len(cells))


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _chance(cell: str) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(hash64(cell)))


if __name__ == "__main__":
    main()
