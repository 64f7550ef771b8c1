"""Statistics of scoring against published values, definitions and examples computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from skyrange.core.errors import InputError
from skyrange.scoring.detector_measures import precision_at, precision_limits
from skyrange.statistics.clusters import draw_weights, percentile_limits
from skyrange.statistics.exact_intervals import (
    load_special,
    lowest_claimable_rate,
    proportion_interval,
    rate_bound,
    rate_interval,
)
from skyrange.statistics.survival import survival_curve

SIX_MP = [6, 6, 6, 7, 10, 13, 16, 22, 23, 6, 9, 10, 11, 17, 19, 20, 25, 32, 32, 34, 35]
"""Weeks in remission with 6-MP: 9 relapses, then 12 censored. Freireich and others, Blood 21 (1963) 699-716."""


def test_clopper_pearson_without_a_hit_has_the_closed_form() -> None:
    for n in (1, 5, 20, 300):
        low, high = proportion_interval(0, n, 0.95)
        assert low == 0.0
        assert high == pytest.approx(1.0 - 0.025 ** (1.0 / n), rel=1e-12)
        assert proportion_interval(n, n, 0.95) == pytest.approx((1.0 - high, 1.0))


@pytest.mark.parametrize(("hits", "trials"), [(1, 29), (15, 148), (81, 263), (3, 4)])
def test_clopper_pearson_limits_have_tails_of_half_alpha(hits: int, trials: int) -> None:
    low, high = proportion_interval(hits, trials, 0.95)

    def at_least(p: float) -> float:
        return sum(math.comb(trials, k) * p**k * (1.0 - p) ** (trials - k) for k in range(hits, trials + 1))

    assert at_least(low) == pytest.approx(0.025, rel=1e-9)
    assert 1.0 - at_least(high) + stats.binom.pmf(hits, trials, high) == pytest.approx(0.025, rel=1e-9)
    expected = stats.beta.ppf(0.025, hits, trials - hits + 1), stats.beta.ppf(0.975, hits + 1, trials - hits)
    assert (low, high) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("p", [0.02, 0.1, 0.37, 0.5, 0.9])
@pytest.mark.parametrize("trials", [5, 30])
def test_clopper_pearson_covers_at_least_as_often_as_it_says(p: float, trials: int) -> None:
    covered = [
        stats.binom.pmf(hits, trials, p)
        for hits in range(trials + 1)
        if (limits := proportion_interval(hits, trials, 0.95))[0] <= p <= limits[1]
    ]
    assert sum(covered) >= 0.95


@pytest.mark.parametrize(
    ("count", "low", "high"),
    [(0, 0.0, 3.689), (10, 4.80, 18.39)],  # epitools `pois.exact` documents 3.689
)
def test_garwood_has_the_published_limits(count: int, low: float, high: float) -> None:
    assert rate_interval(count, 1.0, 0.95) == pytest.approx((low, high), abs=0.005)


def test_garwood_has_the_chi_square_quantiles_per_hour() -> None:
    for count in (1, 2, 7, 200):
        expected = stats.chi2.ppf(0.025, 2 * count) / 2 / 40.0, stats.chi2.ppf(0.975, 2 * count + 2) / 2 / 40.0
        assert rate_interval(count, 40.0, 0.95) == pytest.approx(expected, rel=1e-9)
    assert rate_interval(3, 0.0, 0.95) == (0.0, math.inf)


@pytest.mark.parametrize("mean", [0.2, 1.5, 7.0])
def test_garwood_covers_at_least_as_often_as_it_says(mean: float) -> None:
    covered = [
        stats.poisson.pmf(count, mean)
        for count in range(80)
        if (limits := rate_interval(count, 1.0, 0.95))[0] <= mean <= limits[1]
    ]
    assert sum(covered) >= 0.95


def test_rule_of_three() -> None:
    assert lowest_claimable_rate(1.0, 0.95) == pytest.approx(2.9957, abs=1e-4)
    assert lowest_claimable_rate(100.0, 0.95) == pytest.approx(rate_bound(0, 100.0, 0.95), rel=1e-9)
    assert lowest_claimable_rate(0.0, 0.95) == math.inf


def test_missing_scipy_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "scipy.special", None)
    with pytest.raises(InputError, match=r"skyrange\[study\]"):
        load_special()


def test_kaplan_meier_of_the_6_mp_group_as_by_hand() -> None:
    relapsed = np.arange(21) < 9
    curve = survival_curve(np.array(SIX_MP, dtype=float), relapsed)
    assert curve.times_s.tolist() == [6, 7, 10, 13, 16, 22, 23]
    factors = [18 / 21, 16 / 17, 14 / 15, 11 / 12, 10 / 11, 6 / 7, 5 / 6]
    assert curve.shares[0] == pytest.approx(np.cumprod(factors))
    assert curve.shares[0] == pytest.approx([0.857, 0.807, 0.753, 0.690, 0.627, 0.538, 0.448], abs=5e-4)
    assert curve.medians_s().tolist() == [23.0]


def test_restricted_mean_as_survfit_prints_it() -> None:
    # R: survfit(Surv(c(10, 15, 23, 30, 35, 52, 100), c(1, 1, 1, 1, 1, 1, 0)) ~ 1), print.rmean: 37.9, median 30
    delays = np.array([10.0, 15.0, 23.0, 30.0, 35.0, 52.0, 100.0])
    curve = survival_curve(delays, np.arange(7) < 6)
    assert curve.restricted_means_s(100.0)[0] == pytest.approx(37.85714, abs=1e-5)
    assert curve.medians_s()[0] == 30.0
    assert curve.restricted_means_s(12.0)[0] == pytest.approx((10 + 6 * 12) / 7)


def test_misses_are_no_detections_at_the_end_of_the_window() -> None:
    delays, hits = np.array([1.0, 60.0, 60.0, 60.0]), np.array([True, False, False, False])
    curve = survival_curve(delays, hits)
    assert curve.medians_s()[0] == math.inf
    assert curve.restricted_means_s(60.0)[0] == pytest.approx((1 + 3 * 60) / 4)
    nothing = survival_curve(delays, np.zeros(4, dtype=bool))
    assert nothing.restricted_means_s(60.0).tolist() == [60.0]


def test_weights_are_repetitions() -> None:
    delays, hits = np.array([5.0, 3.0, 9.0, 3.0]), np.array([True, True, False, False])
    weights = np.array([[1.0, 2.0, 0.0, 3.0], [0.0, 0.0, 2.0, 1.0]])
    together = survival_curve(delays, hits, weights)
    for row, mean in zip(weights.astype(int), together.restricted_means_s(8.0), strict=True):
        alone = survival_curve(np.repeat(delays, row), np.repeat(hits, row))
        assert alone.restricted_means_s(8.0)[0] == pytest.approx(mean)


def test_precision_follows_bayes() -> None:
    assert precision_at(0.01, 0.9, 1.0) == pytest.approx(0.009 / 1.009)
    assert precision_at(0.01, 0.0, 0.0) is None
    assert precision_at(0.01, 0.5, math.inf) == 0.0
    recall, rate = proportion_interval(9, 10, 0.975), rate_interval(3, 30.0, 0.975)
    low, high = precision_limits(0.01, recall, rate)
    assert low == pytest.approx(0.01 * recall[0] / (0.01 * recall[0] + rate[1]))
    assert high == pytest.approx(0.01 * recall[1] / (0.01 * recall[1] + rate[0]))
    assert precision_limits(0.01, (0.0, 0.3), (0.0, 0.1)) == (0.0, 1.0)


def test_replicates_draw_as_many_blocks_as_there_are_and_repeat() -> None:
    weights = draw_weights(7, 500, 3)
    assert weights.sum(axis=1).tolist() == [7.0] * 500
    assert np.array_equal(weights, draw_weights.__wrapped__(7, 500, 3))
    assert not np.array_equal(weights, draw_weights(7, 500, 4))
    assert weights.mean(axis=0) == pytest.approx(np.ones(7), abs=6 * math.sqrt(6 / 7 / 500))


def test_percentile_limits_are_samples_and_include_the_point() -> None:
    samples = np.array([*range(1, 100), math.inf])
    assert percentile_limits(samples, 50.0, 0.9) == (5.0, 96.0)
    assert percentile_limits(samples, 200.0, 0.9) == (5.0, 200.0)
    assert percentile_limits(samples, 50.0, 0.999)[1] == math.inf
