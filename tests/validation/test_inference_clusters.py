"""Limits of rates and proportions where flights of a cluster are alike, on samples with a known truth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skyrange.scoring.detector_measures import judge_claim
from skyrange.scoring.result_file import ScoreSettings
from skyrange.statistics.clusters import (
    clustered_proportion_interval,
    clustered_rate_bound,
    clustered_rate_interval,
    estimate_variation,
    find_clusters,
)
from skyrange.statistics.exact_intervals import proportion_interval, rate_bound, rate_interval
from tests.validation.inference_samples import RATES, margin

FAST, THOROUGH = 200, 6_000
REPLICATES = [FAST, pytest.param(THOROUGH, marks=pytest.mark.slow)]


@pytest.mark.parametrize("replicates", REPLICATES)
@pytest.mark.parametrize("clusters", [5, 20, 60])
@pytest.mark.parametrize("rates", RATES)
def test_a_rate_that_is_the_target_is_claimed_to_be_below_it_at_most_as_often_as_stated(
    rates: str, clusters: int, replicates: int
) -> None:
    """The true rate is 1 per hour: to claim at most 1 by chance is what may happen in 5 % of the studies."""
    chance, hours = np.random.default_rng(1), np.full(clusters, 60.0 / clusters)
    claimed, by_poisson = 0, 0
    for _ in range(replicates):
        counts = chance.poisson(RATES[rates](chance, clusters) * hours).astype(np.float64)
        claimed += judge_claim(counts, hours, ScoreSettings(target_per_h=1.0)).verdict == "claimed"
        by_poisson += rate_bound(int(counts.sum()), 60.0, 0.95) <= 1.0
    assert claimed / replicates <= 0.05 + margin(0.05, replicates)
    if rates != "equal":
        assert by_poisson / replicates > 0.1, "Garwood's limit alone claims too often"


@pytest.mark.parametrize("replicates", REPLICATES)
@pytest.mark.parametrize("clusters", [5, 10, 20, 60])
def test_two_sided_limits_of_a_rate_cover_it(clusters: int, replicates: int) -> None:
    chance, hours = np.random.default_rng(3), [2.0] * clusters
    covered = 0
    for _ in range(replicates):
        counts = chance.poisson(chance.gamma(0.25, 4.0, clusters) * 2.0)
        low, high = clustered_rate_interval(counts.tolist(), hours, 2.0, 0.95)
        covered += low <= 1.0 <= high
    assert covered / replicates >= 0.95 - margin(0.95, replicates)


@pytest.mark.parametrize("replicates", REPLICATES)
@pytest.mark.parametrize(("clusters", "alike"), [(5, 0.3), (10, 0.3), (20, 0.6), (60, 0.6)])
@pytest.mark.parametrize("share", [0.5, 0.8])
def test_limits_of_a_proportion_cover_it_where_attacks_of_a_cluster_are_alike(
    share: float, clusters: int, alike: float, replicates: int
) -> None:
    """Six attacks in each cluster, with the intra-cluster correlation `alike`."""
    chance, size = np.random.default_rng(4), (1.0 - alike) / alike
    covered, by_rows = 0, 0
    names = np.repeat(np.arange(clusters), 6).tolist()
    for _ in range(replicates):
        of_cluster = chance.beta(share * size, (1.0 - share) * size, clusters)
        hits = (chance.random((clusters, 6)) < of_cluster[:, np.newaxis]).ravel()
        limits = clustered_proportion_interval(hits.tolist(), names, 0.95)
        assert limits is not None
        covered += limits[0] <= share <= limits[1]
        exact = proportion_interval(int(hits.sum()), hits.size, 0.95)
        by_rows += exact[0] <= share <= exact[1]
    assert covered / replicates >= 0.95 - margin(0.95, replicates) - 0.015  # with the variance of few clusters
    assert by_rows / replicates < 0.9, "as if attacks were independent, the limits are too narrow"


def test_limits_in_closed_form() -> None:
    assert clustered_rate_interval([3.0, 4.0], [2.0, 2.0], 0.0, 0.95) == rate_interval(7, 4.0, 0.95)
    none = clustered_rate_bound([0.0] * 20, [1.0] * 20, 2.0, 0.95)
    assert none == pytest.approx((0.05 ** (-1.0 / 5.0) - 1.0) * 5.0 / 20.0)  # (p / (1 - p))^shape = 0.05
    assert clustered_rate_interval([], [], 2.0, 0.95) == (0.0, math.inf)
    assert estimate_variation([1.0, 1.0, 1.0], [1.0] * 3) == 0.0
    assert estimate_variation([0.0, 0.0, 300.0], [1.0] * 3) == pytest.approx(math.sqrt(2.0 - 0.01))
    every = clustered_proportion_interval([True] * 6, [1, 1, 2, 2, 3, 3], 0.95)
    assert every is not None
    assert every == pytest.approx((0.025 ** (1 / 3), 1.0))
    assert clustered_proportion_interval([True, False], ["one", "one"], 0.95) is None


def test_clusters_are_chains_of_what_is_shared() -> None:
    shared = {"a": ["seed 1", "flight x"], "b": ["seed 2"], "c": ["seed 3", "flight x"], "d": ["seed 3"], "e": []}
    assert find_clusters(shared) == {"a": "a", "b": "b", "c": "a", "d": "a", "e": "e"}
    late = {"a": ["1"], "b": ["2"], "c": ["2", "1"]}
    assert set(find_clusters(late).values()) == {"a"}
