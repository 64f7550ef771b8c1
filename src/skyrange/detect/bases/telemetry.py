"""Base of detectors that compare telemetry: residuals at each link end, and the alerts for those above thresholds.

The statistic is the one-sided CUSUM S = max(0, S + |r| - b) of E. S. Page, "Continuous Inspection Schemes", Biometrika
41 (1954): r is a residual in standard deviations, b its allowance, and S is compared with a threshold. S is cut at
`MOST_SCORE` thresholds, so that it is back below its threshold soon after the residual is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Final

import numpy as np

from skyrange.contracts.alerts import Alert, Scalar
from skyrange.contracts.frames import Ints
from skyrange.contracts.monitors import DetectorContext, Monitor, ObservedFrames
from skyrange.core.time import Time
from skyrange.detect.bases.scores import ScoreDetector
from skyrange.detect.series import Floats, grown, rounds

MOST_SCORE: Final = 10.0


class TelemetryDetector(ScoreDetector):
    """Compares the telemetry that arrives at link ends. Its residuals have names, and episodes at every link end.

    The score of an alert is a statistic over its threshold. `data` has the link and the name of the residual.
    """

    needs: ClassVar[tuple[str, ...]] = ("compare",)
    residuals: ClassVar[tuple[str, ...]] = ()
    """Their names."""

    sums: Floats
    """(ends, residuals) the CUSUMs."""

    def assemble(self, context: DetectorContext) -> Monitor:
        """See `Detector`."""
        self.sums = np.zeros((0, len(self.residuals)))
        return super().assemble(context)

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Compare what has arrived since the last service."""
        return self.compare(now, frames.take(frames.received))

    def compare(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """The alerts about frames that have arrived."""
        raise NotImplementedError

    def accumulate(self, name: str, places: Ints, excess: Floats, threshold: float) -> Floats:
        """Add (n,) terms |r| - b to the CUSUMs of a residual; returns the (n,) scores S over threshold after each.

        `places` are link ends, those of one end in order of time. A term that is not finite changes nothing.
        """
        self.sums = grown(self.sums, int(places.max(initial=-1)) + 1)
        column = self.residuals.index(name)
        sums, scores = self.sums, np.zeros(len(places))
        terms = np.nan_to_num(excess, nan=0.0, posinf=MOST_SCORE * threshold, neginf=0.0)
        for rows in rounds(places):
            at = places[rows]
            sums[at, column] = np.clip(sums[at, column] + terms[rows], 0.0, MOST_SCORE * threshold)
            scores[rows] = sums[at, column] / threshold
        return scores

    def alerts(
        self, name: str, frames: ObservedFrames, places: Ints, at_ns: Ints | Time, scores: Floats, **data: Floats
    ) -> list[Alert]:
        """The alerts of (n,) scores of a residual at link ends, by `Episodes`; `data` are details, (n,) each."""
        streams = places * len(self.residuals) + self.residuals.index(name)
        rows, found = self.episodes.update(at_ns, streams, scores)
        times = np.broadcast_to(np.asarray(at_ns, dtype=np.int64), scores.shape)
        alerts = []
        for row, score in zip(rows.tolist(), found.tolist(), strict=True):
            said: dict[str, Scalar] = {"residual": name}
            said |= {key: float(values[row]) for key, values in data.items() if np.isfinite(values[row])}
            alerts.append(self.alert(int(times[row]), frames.ports[places[row]].link, score, said))
        return alerts
