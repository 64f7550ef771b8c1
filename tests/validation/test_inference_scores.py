"""Numbers of scores and of a matrix's costs on made-up studies whose truth is known."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from skyrange.core.time import NS_PER_S
from skyrange.scoring.detector_measures import MANY_CLUSTERS, measure_delay, measure_false_alarms
from skyrange.scoring.index import index_alerts, index_study
from skyrange.scoring.matching import choose_threshold, match_alarms
from skyrange.scoring.result_file import ScoreSettings
from skyrange.scoring.tables import keep_each_flight_once
from skyrange.statistics.means import estimate_mean
from skyrange.study.matrix.summary import mean_over_rows
from tests.unit.score_sample import alert, attack, flight, tables
from tests.validation.inference_samples import margin

EPISODE_NS = 30 * NS_PER_S
REPLICATES = [60, pytest.param(600, marks=pytest.mark.slow)]


@pytest.mark.parametrize("replicates", REPLICATES)
def test_a_flight_that_is_flown_at_sixteen_points_is_no_more_evidence(replicates: int) -> None:
    """Ten flights of an hour with a rate of 1, each in 16 runs: Garwood's limits cover it if copies do not count."""
    chance, covered, copied = np.random.default_rng(5), 0, 0
    for _ in range(replicates):
        alarms = [chance.uniform(0.0, 3600.0, chance.poisson(1.0)).tolist() for _ in range(10)]
        flights = [flight(f"{n}-{k}", flight=f"f{n}", cluster=f"c{n}") for n in range(10) for k in range(16)]
        alerts = [alert(f"{n}-{k}", at) for n, own in enumerate(alarms) for k in range(16) for at in own]
        every = tables(flights, (), alerts)
        once, repeated = keep_each_flight_once(every)
        assert repeated == 150
        for given, kept in ((once, True), (every, False)):
            index = index_study(given, 10.0)
            outcome = match_alarms(index, index_alerts(index, given.alerts, "d"), -math.inf, 1)
            subjects = np.ones(len(index.subjects.runs), dtype=np.bool_)
            per_h = measure_false_alarms(index, outcome.false_alarms, subjects, ScoreSettings()).per_h
            assert per_h is not None
            low, high = per_h.exact
            holds = low <= 1.0 <= (math.inf if high is None else high)
            covered += holds and kept
            copied += holds and not kept
    assert covered / replicates >= 0.95 - margin(0.95, replicates)
    assert copied / replicates < 0.75


@pytest.mark.parametrize("replicates", REPLICATES)
def test_the_rate_that_a_threshold_reaches_is_within_its_limits(replicates: int) -> None:
    """Of 1.6 hours, with a detector whose rate of false alarms above a score s is 10 exp(-s) per hour.

    The target is 1 per hour. What is reached on other flights is what the limits are of; it is off the target by far.
    """
    chance, covered, reached = np.random.default_rng(1), 0, []
    settings = ScoreSettings()
    for _ in range(replicates):
        flights = [flight(f"v{n}", split="validation", duration_s=288.0) for n in range(20)]
        alerts = [
            alert(one["run"], chance.uniform(0.0, 288.0), score=chance.exponential(1.0))
            for one in flights
            for _ in range(chance.poisson(0.8))
        ]
        given = tables(flights, (), alerts)
        index = index_study(given, 10.0)
        choice = choose_threshold(index, index_alerts(index, given.alerts, "d"), 1.0, EPISODE_NS)
        truth = 10.0 * math.exp(-max(choice.threshold, 0.0))
        per_h = measure_false_alarms(index, choice.episodes, choice.used, settings).per_h
        assert per_h is not None
        assert per_h.clustered is not None
        low, high = per_h.clustered
        covered += low <= truth <= (math.inf if high is None else high)
        reached.append(truth)
    assert covered / replicates >= 0.95 - margin(0.95, replicates)
    assert np.quantile(reached, 0.1) < 0.6
    assert np.quantile(reached, 0.9) > 1.8


@pytest.mark.parametrize("replicates", [40, pytest.param(400, marks=pytest.mark.slow)])
def test_limits_of_delays_cover_them_with_clusters_enough(replicates: int) -> None:
    """Delays are exponential with a mean of 20 s that differs between clusters; windows end after 60 s."""
    chance, covered = np.random.default_rng(2), np.zeros(2)
    scales = 20.0 * np.exp(np.random.default_rng(0).normal(0.0, 0.5, 200_000))
    truth = np.minimum(np.random.default_rng(3).exponential(scales), 1e9)
    median, mean = float(np.median(truth)), float(np.minimum(truth, 60.0).mean())
    settings = ScoreSettings(replicates=400)
    for _ in range(replicates):
        flights, acts, alerts = [], [], []
        for cluster in range(MANY_CLUSTERS):
            scale = 20.0 * math.exp(chance.normal(0.0, 0.5))
            for n in range(3):
                run = f"{cluster}-{n}"
                flights.append(flight(run, arm="attacked", block=f"b{cluster}"))
                acts.append(attack(run, active_s=1000.0, observable_s=1000.0, stop_s=1060.0))
                delay_s = chance.exponential(scale)
                alerts += [alert(run, 1000.0 + delay_s)] if delay_s <= 60.0 else []
        given = tables(flights, acts, alerts)
        index = index_study(given, 0.0)
        outcome = match_alarms(index, index_alerts(index, given.alerts, "d"), -math.inf, EPISODE_NS)
        found = measure_delay(index, outcome, np.arange(len(acts)), settings)
        for place, (limits, true) in enumerate(
            ((found.median_clusters, median), (found.restricted_mean_clusters, mean))
        ):
            assert limits is not None
            covered[place] += limits[0] <= true <= (math.inf if limits[1] is None else limits[1])
    assert (covered / replicates >= 0.95 - margin(0.95, replicates) - 0.03).all()


@pytest.mark.parametrize("replicates", [400, pytest.param(4_000, marks=pytest.mark.slow)])
def test_the_cost_of_a_defence_is_a_mean_over_seeds(replicates: int) -> None:
    """Eight rows of five seeds and three aircraft that share the chance of a flight: pooled, they cover too rarely."""
    chance, covered, pooled = np.random.default_rng(4), 0, 0
    of_rows = np.linspace(0.0, 4.0, 8)
    for _ in range(replicates):
        of_flight = of_rows[:, np.newaxis] + chance.normal(0.0, 1.0, 5) + chance.normal(0.0, 0.5, (8, 5))
        aircraft = of_flight[:, :, np.newaxis] + chance.normal(0.0, 0.1, (8, 5, 3))
        rows: Sequence[Sequence[float]] = aircraft.mean(axis=2).tolist()
        for estimate, count in ((mean_over_rows(rows), "seeds"), (estimate_mean(aircraft.ravel().tolist()), "pooled")):
            assert estimate is not None
            assert estimate.low is not None
            assert estimate.high is not None
            holds = estimate.low <= 2.0 <= estimate.high
            covered += holds and count == "seeds"
            pooled += holds and count == "pooled"
    assert covered / replicates >= 0.95 - margin(0.95, replicates)
    assert pooled / replicates < 0.8


def test_a_row_without_a_delay_in_some_seed_is_left_out() -> None:
    found = mean_over_rows([[0.0, 0.0, 0.0], [math.nan, 100.0, 100.0], [1.0, 2.0, 3.0]])
    assert found is not None
    assert (found.n, found.mean) == (3, 1.0), "the row that lacks a seed is left out: no spread is made of it"
    assert mean_over_rows([[math.nan]]) is None
