"""Residuals of each link end: CUSUM statistics, and the alerts for those that exceed their thresholds.

The statistic is the one-sided CUSUM S = max(0, S + |r| - b) of E. S. Page, "Continuous Inspection Schemes", Biometrika
41 (1954): r is a residual in standard deviations, b its allowance, and S is compared with a threshold. S is cut at
`MOST_SCORE` thresholds, so that it is back below its threshold soon after the residual is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from skyrange.contracts.alerts import Alert
from skyrange.contracts.frames.payloads import Ints
from skyrange.contracts.scalars import Scalar
from skyrange.core.ids import Port
from skyrange.core.time import Time
from skyrange.detect.episodes import EpisodeParams, Episodes, subject_of_link
from skyrange.detect.series import Floats, grown, rounds

MOST_SCORE: Final = 10.0


class Residuals:
    """The residuals of one detector: named, with a CUSUM and episodes of alerts for each at every link end."""

    def __init__(self, kind: str, names: Sequence[str], params: EpisodeParams) -> None:
        self._kind = kind
        self._names = tuple(names)
        self._episodes = Episodes(params)
        self._sums: Floats = np.zeros((0, len(self._names)))

    def add(self, name: str, places: Ints, excess: Floats, threshold: float) -> Floats:
        """Add (n,) terms |r| - b to the CUSUMs of a residual; returns the (n,) scores S over threshold after each.

        `places` are link ends, those of one end in order of time. A term that is not finite changes nothing.
        """
        self._sums = grown(self._sums, int(places.max(initial=-1)) + 1)
        column = self._names.index(name)
        sums, scores = self._sums, np.zeros(len(places))
        terms = np.nan_to_num(excess, nan=0.0, posinf=MOST_SCORE * threshold, neginf=0.0)
        for rows in rounds(places):
            at = places[rows]
            sums[at, column] = np.clip(sums[at, column] + terms[rows], 0.0, MOST_SCORE * threshold)
            scores[rows] = sums[at, column] / threshold
        return scores

    def raise_alerts(
        self,
        name: str,
        ports: Sequence[Port],
        places: Ints,
        at_ns: Ints | Time,
        scores: Floats,
        data: Mapping[str, Floats] | None = None,
    ) -> list[Alert]:
        """The alerts of (n,) scores of a residual at link ends, by `Episodes`; `data` are details, (n,) each."""
        streams = places * len(self._names) + self._names.index(name)
        rows, found = self._episodes.update(at_ns, streams, scores)
        times = np.broadcast_to(np.asarray(at_ns, dtype=np.int64), scores.shape)
        alerts = []
        for row, score in zip(rows.tolist(), found.tolist(), strict=True):
            link = ports[places[row]].link
            said: dict[str, Scalar] = {"link": link, "residual": name}
            for key, values in (data or {}).items():
                if np.isfinite(values[row]):
                    said[key] = float(values[row])
            alerts.append(Alert(int(times[row]), subject_of_link(link), self._kind, score, said))
        return alerts
