"""Scores on generated studies: what must hold for any flights, attacks and alerts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from skyrange.core.time import NEVER, NS_PER_S
from skyrange.scoring.chance import trivial_alerts
from skyrange.scoring.index import index_alerts, index_study
from skyrange.scoring.leaderboard import rank_detectors
from skyrange.scoring.matching import Outcome, find_episodes, match_alarms
from skyrange.scoring.result_file import Estimate, ScoreSettings
from skyrange.scoring.scores import score_detectors
from skyrange.scoring.tables import StudyTables
from skyrange.statistics.exact_intervals import proportion_interval, rate_interval
from tests.unit.score_sample import alert, attack, flight, tables

pytestmark = pytest.mark.rotating

EPISODE_NS = 20 * NS_PER_S
SETTINGS = ScoreSettings(replicates=100, episode_s=20.0)
ARMS = ("nominal", "attacked", "sham", "fault")
anytime = settings(deadline=None)
"""The first example loads compiled functions."""
Rows = list[dict[str, Any]]

moments = st.integers(0, 599).map(float)
alarms = st.lists(st.tuples(moments, st.sampled_from(("a", "b", "")), st.integers(0, 4)), max_size=12)


@st.composite
def studies(draw: st.DrawFn) -> tuple[Rows, Rows, Rows]:
    """Flights of three to six blocks, each with all arms; attacks on one aircraft or on all; alerts of a detector."""
    flights, attacks, alerts = Rows(), Rows(), Rows()
    for number in range(draw(st.integers(3, 6))):
        split = ("test", "validation", "train")[number % 3]
        for arm in ARMS:
            run = f"{number}-{arm}"
            of_run: dict[str, Any] = {
                "arm": arm,
                "block": f"{number}",
                "split": split,
                "aircraft": 2,
                "city": f"city {number % 2}",
                "duration_s": 600.0,
            }
            flights += [flight(run, name, **of_run) for name in ("a", "b")]
            alerts += [alert(run, time, subject, score=float(score)) for time, subject, score in draw(alarms)]
        begin = draw(moments)
        seen = draw(st.sampled_from((0.0, 5.0, 200.0, math.nan)))
        lasts = draw(st.sampled_from((0.0, 30.0, 100.0)))
        attacks.append(
            attack(
                f"{number}-attacked",
                draw(st.sampled_from(("a", ""))),
                active_s=begin,
                stop_s=begin + lasts,
                observable_s=begin + seen,
                effect_s=begin + draw(st.sampled_from((0.0, 20.0, math.nan))),
                kind=draw(st.sampled_from(("gnss.drift", "gnss.jump"))),
            )
        )
    return flights, attacks, alerts


def match(study: StudyTables, threshold: float = -math.inf) -> Outcome:
    index = index_study(study, 10.0)
    return match_alarms(index, index_alerts(index, study.alerts, "d"), threshold, EPISODE_NS)


few = st.lists(st.integers(0, 60), max_size=7)


@anytime
@given(few, few, st.integers(1, 25))
def test_episodes_are_the_fewest_intervals_and_grow_with_alerts(some: list[int], more: list[int], length: int) -> None:
    def count(times: Sequence[int]) -> int:
        ordered = np.array(sorted(times), dtype=np.int64)
        return int(find_episodes(np.zeros_like(ordered), ordered, length).sum())

    def is_covered(begins: Sequence[int]) -> bool:
        return all(any(begin <= time < begin + length for begin in begins) for time in some)

    sizes = range(len(some) + 1)
    assert count(some) == next(size for size in sizes if any(map(is_covered, combinations(sorted(some), size))))
    assert count(some) <= count(some + more) <= count(some) + count(more)


@anytime
@given(studies(), st.integers(0, 5), moments, st.sampled_from(("a", "b", "")), st.sampled_from(ARMS))
def test_one_more_alert_lowers_neither_false_alarms_nor_recall(
    study: tuple[Rows, Rows, Rows], block: int, time: float, subject: str, arm: str
) -> None:
    flights, attacks, alerts = study
    run = f"{block}-{arm}"
    assume(any(one["run"] == run for one in flights))
    before = match(tables(flights, attacks, alerts))
    after = match(tables(flights, attacks, [*alerts, alert(run, time, subject)]))
    assert (after.false_alarms >= before.false_alarms).all()
    assert (after.detected_ns <= before.detected_ns).all()


@anytime
@given(studies())
def test_a_lower_threshold_lowers_neither_recall_nor_false_alarms(study: tuple[Rows, Rows, Rows]) -> None:
    given_tables = tables(*study)
    outcomes = [match(given_tables, threshold) for threshold in (4.0, 3.0, 2.0, 1.0, 0.0, -math.inf)]
    for strict, loose in pairwise(outcomes):
        assert (loose.false_alarms >= strict.false_alarms).all()
        assert (loose.detected_ns <= strict.detected_ns).all()
    assert (outcomes[0].detected_ns == NEVER).all()


@anytime
@given(studies())
def test_always_detects_all_at_the_worst_rate_and_never_nothing(study: tuple[Rows, Rows, Rows]) -> None:
    flights, attacks, alerts = study
    given_tables = tables(flights, attacks, [one for one in alerts if one["subject"]])
    index = index_study(given_tables, 10.0)
    trivial = {
        name: match_alarms(index, found, -math.inf, EPISODE_NS)
        for name, found in trivial_alerts(index, EPISODE_NS).items()
    }
    always, never, mine = trivial["always"], trivial["never"], match(given_tables)
    assert (always.detected_ns == index.attacks.begin_ns).all()
    assert (never.detected_ns == NEVER).all()
    assert not never.false_alarms.any()
    for other in (mine, *trivial.values()):
        assert (always.false_alarms >= other.false_alarms).all()


@settings(deadline=None, max_examples=15)
@given(studies(), st.randoms(use_true_random=False))
def test_the_order_of_rows_changes_nothing_and_intervals_contain_their_points(
    study: tuple[Rows, Rows, Rows], random: Any
) -> None:
    file = score_detectors(tables(*study), SETTINGS, ["d"])
    shuffled = [random.sample(rows, len(rows)) for rows in study]
    assert score_detectors(tables(*shuffled), SETTINGS, ["d"]) == file
    for score in file.detectors:
        for one in score.sets:
            estimates = [found.per_h for _, found in one.false_alarms]
            for group in (one.detection, *one.kinds, *one.families):
                estimates += [group.recall, group.before_effect.share if group.before_effect else None]
                if group.delay is not None:
                    assert group.delay.restricted_mean_clusters is None, "there are fewer clusters than that takes"
                    assert group.delay.restricted_mean_s <= group.delay.horizon_s + 1e-9
            check = [found for found in estimates if isinstance(found, Estimate)]
            assert check
            for found in check:
                for limits in (found.exact, found.clustered):
                    assert limits is None or limits[0] <= found.value <= (math.inf if limits[1] is None else limits[1])
            for precision in one.precision:
                low, high = precision.limits
                assert precision.value is None or low <= precision.value <= high
    rows = rank_detectors([file])
    assert sorted(row.detector for row in rows) == sorted(score.detector for score in file.detectors)


@anytime
@given(st.integers(0, 300), st.integers(0, 300), st.floats(0.01, 1000.0), st.floats(0.55, 0.999))
def test_exact_intervals_contain_their_points(hits: int, misses: int, hours: float, confidence: float) -> None:
    assume(hits + misses > 0)
    low, high = proportion_interval(hits, hits + misses, confidence)
    assert 0.0 <= low <= hits / (hits + misses) <= high <= 1.0
    low, high = rate_interval(hits, hours, confidence)
    assert 0.0 <= low <= hits / hours <= high
    wider = rate_interval(hits, hours, (1.0 + confidence) / 2.0)
    assert wider[0] <= low
    assert high <= wider[1]
