"""Episodes of alerts: when a score that stays high raises an alert, and when it raises one again."""

from __future__ import annotations

import copy

import numpy as np

from skyrange.core.time import NS_PER_S
from skyrange.detect.episodes import MAX_SCORE, Episodes, subject_of_link


def _raised(episodes: Episodes, at_s: float, **scores: float) -> dict[str, float]:
    """The streams (named a, b, …) that raise an alert at one time, with the scores of their alerts."""
    streams = np.array([ord(name) - ord("a") for name in scores], dtype=np.int64)
    values = np.array(list(scores.values()), dtype=np.float64)
    rows, found = episodes.update(int(at_s * NS_PER_S), streams, values)
    return {list(scores)[row]: score for row, score in zip(rows.tolist(), found.tolist(), strict=True)}


def test_an_alert_at_the_beginning_again_when_the_score_doubles_and_in_the_next_episode() -> None:
    episodes = Episodes(quiet_s=2)
    assert _raised(episodes, 0, a=0.9, b=1.5) == {"b": 1.5}
    assert _raised(episodes, 1, a=1.0, b=2.9) == {"a": 1.0}
    assert _raised(episodes, 2, a=1.9, b=3.0) == {"b": 3.0}
    assert _raised(episodes, 4, a=1.9, b=0.5) == {}
    assert _raised(episodes, 5, a=1.9, b=1.2) == {"b": 1.2}
    assert _raised(episodes, 7.5, a=float("nan"), b=1.2) == {"b": 1.2}


def test_several_scores_of_a_stream_raise_one_alert_with_the_highest() -> None:
    episodes = Episodes(report_above=0.5)
    at = np.array([1, 2, 3, 4], dtype=np.int64) * NS_PER_S
    rows, scores = episodes.update(at, np.array([7, 2, 7, 7]), np.array([0.6, 0.5, 0.9, 0.9]))
    assert (rows.tolist(), scores.tolist()) == ([1, 2], [0.5, 0.9])


def test_scores_are_cut_and_copies_are_independent() -> None:
    episodes = Episodes()
    twin = copy.deepcopy(episodes)
    assert _raised(episodes, 0, a=float("inf")) == {"a": MAX_SCORE}
    assert _raised(episodes, 1, a=float("inf")) == {}
    assert _raised(twin, 1, a=3.0) == {"a": 3.0}


def test_subject() -> None:
    assert subject_of_link("gcs:blue/b1") == "blue/b1"
    assert subject_of_link("oracle") == "oracle"
