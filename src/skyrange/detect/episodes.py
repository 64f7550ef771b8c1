"""Episodes of alerts: when a detector raises an alert for a statistic that stays high, as columns over many streams.

A *stream* is what a detector keeps one statistic for: a link, a sender, an aircraft. A detector gives every stream a
number 0, 1, 2 … and computes *scores*: its statistic divided by its default threshold, so that 1 is the default
threshold of every detector. An episode of a stream begins with a score of at least `report_above`, and ends when no
score has reached it for `quiet_s`. An alert is raised at the beginning, and again whenever the score is at least
twice that of the last alert. So a run with a low `report_above` contains the alerts of higher thresholds, to a factor
of two of the score, except that excursions within one episode are not told apart.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.frames import Ints
from skyrange.core.time import Time, from_seconds

MAX_SCORE = 1e6
"""Scores are cut at this value, so that one episode has at most a few dozen alerts."""
RAISED_AGAIN = 2.0
"""Ratio of a score to that of the last alert at which an alert is raised again within an episode."""
_NEVER = -(2**62)


class Episodes:
    """The episodes of all streams of one detector. Its state is arrays of one value per stream."""

    def __init__(self, report_above: float = 1.0, quiet_s: float = 5.0) -> None:
        self._least = report_above
        self._quiet_ns = from_seconds(quiet_s)
        self._last_ns = np.full(0, _NEVER, dtype=np.int64)
        self._raised = np.zeros(0)

    def update(
        self, at_ns: Ints | Time, streams: Ints, scores: NDArray[np.float64]
    ) -> tuple[Ints, NDArray[np.float64]]:
        """Take in the scores since the last call, which raise at most one alert per stream.

        `streams` are (n,) numbers of streams, which may repeat; `scores` are (n,), where NaN counts as none; `at_ns` is
        the time of all, or (n,) times. Returns the m rows that raise an alert, in order, and their (m,) finite scores:
        for each stream the row with its highest score, the first among equals.
        """
        rows = np.flatnonzero(scores >= self._least)
        if not len(rows):
            return rows, np.zeros(0)
        rows = rows[np.lexsort((rows, -scores[rows], streams[rows]))]
        chosen, first = np.unique(streams[rows], return_index=True)
        self._grow(int(chosen[-1]) + 1)
        times = np.broadcast_to(np.asarray(at_ns, dtype=np.int64), scores.shape)
        begin = np.minimum.reduceat(times[rows], first)
        end = np.maximum.reduceat(times[rows], first)
        peaks = rows[first]
        peak_scores = np.minimum(scores[peaks], MAX_SCORE)
        is_new = begin - self._last_ns[chosen] > self._quiet_ns
        raised = is_new | (peak_scores >= RAISED_AGAIN * self._raised[chosen])
        self._last_ns[chosen] = np.maximum(end, self._last_ns[chosen])
        self._raised[chosen[raised]] = peak_scores[raised]
        order = np.argsort(peaks[raised], kind="stable")
        return peaks[raised][order], peak_scores[raised][order]

    def _grow(self, count: int) -> None:
        missing = count - len(self._raised)
        if missing > 0:
            missing = max(missing, len(self._raised))
            self._last_ns = np.concatenate([self._last_ns, np.full(missing, _NEVER, dtype=np.int64)])
            self._raised = np.concatenate([self._raised, np.zeros(missing)])


def subject_of_link(link: str) -> str:
    """The subject of alerts about a link: its owner, such as `blue/b1` of `gcs:blue/b1`."""
    return link.partition(":")[2] or link
