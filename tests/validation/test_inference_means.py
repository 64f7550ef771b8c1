"""Intervals of means on samples with a known mean: do they cover it as often as they say, or say that they do not?"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from skyrange.statistics.means import BOOTSTRAP_FROM, MOST_AGREE_FROM, SKEWED, estimate_mean, t_tail
from tests.validation.inference_samples import DISTRIBUTIONS, margin
from tools.docs import measure_coverage


def coverage(name: str, count: int, replicates: int, seed: int = 1) -> tuple[float, float]:
    """The share of replicates with an interval, and the share of these that cover the mean."""
    chance, drawn = np.random.default_rng(seed), DISTRIBUTIONS[name]
    covered = []
    for _ in range(replicates):
        found = estimate_mean(drawn.draw(chance, count).tolist(), yes_or_no=name == "yes or no")
        assert found is not None
        if found.low is not None and found.high is not None:
            covered.append(found.low <= drawn.mean <= found.high)
    return len(covered) / replicates, float(np.mean(covered)) if covered else math.nan


FAST, THOROUGH = 120, 4_000
REPLICATES = [FAST, pytest.param(THOROUGH, marks=pytest.mark.slow)]


@pytest.mark.parametrize("replicates", REPLICATES)
@pytest.mark.parametrize("count", [2, 3, 5, 10, 20, 40])
def test_intervals_of_normal_samples_cover_the_mean(count: int, replicates: int) -> None:
    shown, covered = coverage("normal", count, replicates)
    assert shown == 1.0
    assert covered >= 0.95 - margin(0.95, replicates) - 0.005  # bootstrap-t is exact in the limit alone


@pytest.mark.parametrize("replicates", REPLICATES)
@pytest.mark.parametrize("count", [3, 5, 10, 20, 40])
def test_shares_of_yes_and_no_cover_theirs(count: int, replicates: int) -> None:
    assert coverage("yes or no", count, replicates)[1] >= 0.95 - margin(0.95, replicates)


@pytest.mark.parametrize("replicates", REPLICATES)
@pytest.mark.parametrize("count", [5, 10, 20, 39])
def test_samples_that_are_mostly_zero_have_no_interval_while_no_method_covers(count: int, replicates: int) -> None:
    shown, _ = coverage("80 % zeros", count, replicates)
    assert shown < 0.1
    found = estimate_mean([0.0] * (count - 1) + [7.0])
    assert found is not None
    assert (found.low, found.without) == (None, "most agree")


@pytest.mark.parametrize("replicates", REPLICATES)
@pytest.mark.parametrize("zeros", [80, 90, 95])
@pytest.mark.parametrize("count", [MOST_AGREE_FROM, 100, 200])
def test_of_many_samples_that_are_mostly_zero_wrong_intervals_are_rare(zeros: int, count: int, replicates: int) -> None:
    """What counts is how often a reader is told something false; with few others there is no interval at all."""
    shown, covered = coverage(f"{zeros} % zeros", count, replicates)
    assert shown * (1.0 - covered if shown else 0.0) <= 0.05 + margin(0.05, replicates) + 0.01
    if (100 - zeros) / 100 * count >= 15:
        assert shown > 0.9


@pytest.mark.parametrize("replicates", REPLICATES)
def test_samples_of_one_cluster_count_once(replicates: int) -> None:
    """16 points are flown with each of 5 seeds, which decide everything: the interval is that of 5 samples."""
    chance = np.random.default_rng(2)
    covered = []
    for _ in range(replicates):
        of_seed = np.repeat(chance.normal(0.0, 1.0, 5), 16)
        found = estimate_mean(of_seed.tolist(), [k // 16 for k in range(80)])
        assert found is not None
        assert found.n == 5
        assert found.low is not None
        assert found.high is not None
        covered.append(found.low <= 0.0 <= found.high)
    assert np.mean(covered) >= 0.95 - margin(0.95, replicates)


def test_a_difference_is_no_yes_or_no() -> None:
    """One of five seeds has a near miss more: nothing that an interval could show, and least of all one above zero."""
    found = estimate_mean([1.0, 0.0, 0.0, 0.0, 0.0])
    assert found is not None
    assert (found.low, found.without) == (None, "most agree")
    share = estimate_mean([1.0, 0.0, 0.0, 0.0, 0.0], yes_or_no=True)
    assert share is not None
    assert share.method == "Clopper-Pearson"


def test_what_has_no_interval_says_why() -> None:
    for samples, why in (([3.0], "one sample"), ([2.0] * 4, "all 4 agree"), ([0.0, 0.0, 0.0, 5.0], "most agree")):
        found = estimate_mean(samples)
        assert found is not None
        assert (found.low, found.high, found.without) == (None, None, why)
        assert not found.excludes_zero
    assert estimate_mean([]) is None


def test_the_interval_depends_on_the_samples_alone() -> None:
    samples = np.random.default_rng(3).exponential(1.0, BOOTSTRAP_FROM).tolist()
    assert estimate_mean(samples) == estimate_mean(samples[::-1])
    few = samples[:5]
    found = estimate_mean(few)
    assert found is not None
    expected = stats.t.interval(0.95, 4, np.mean(few), stats.sem(few))
    assert (found.low, found.high) == pytest.approx(expected)


@pytest.mark.parametrize("freedom", [1, 2, 5, 30])
def test_the_tail_of_t_is_that_of_scipy(freedom: int) -> None:
    for t in (-3.0, -0.1, 0.0, 0.5, 2.0, 12.0):
        assert t_tail(t, freedom) == pytest.approx(stats.t.sf(t, freedom), abs=1e-12)


@pytest.mark.slow
def test_the_page_of_measured_coverage_says_what_is_measured() -> None:
    lines = measure_coverage.PAGE.read_text(encoding="utf-8").splitlines()
    for name, count in (("normal", 3), ("lognormal", 10), ("80 % zeros", 19), ("half zeros", 40)):
        cells = next(line for line in lines if line.startswith(f"| {name} |")).strip("| ").split(" | ")
        assert cells[1 + measure_coverage.COUNTS.index(count)] == measure_coverage.measure_mean(name, count)


def test_what_reports_say_of_skewed_data_is_on_the_page() -> None:
    page = Path(__file__).parents[2] / "docs" / "reference" / "coverage.md"
    lines = page.read_text(encoding="utf-8").splitlines()
    head = next(line for line in lines if line.startswith("| samples |")).strip("| ").split(" | ")
    few = [place for place, text in enumerate(head) if text.isdigit() and int(text) < BOOTSTRAP_FROM]
    found = [
        int(re.sub(r"\D", "", line.strip("| ").split(" | ")[place]))
        for line in lines
        if line.startswith(("| exponential |", "| lognormal |"))
        for place in few
    ]
    assert f"{min(found)} to {max(found)} %" == SKEWED
