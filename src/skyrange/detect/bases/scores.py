"""Base of detectors that compute scores: a statistic of each stream, divided by its default threshold."""

from __future__ import annotations

from skyrange.contracts.monitors import DetectorContext, Monitor
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.form import param
from skyrange.detect.declaration import Detector
from skyrange.detect.episodes import Episodes


class ScoreDetector(Detector):
    """Raises alerts at the beginning of episodes of high scores, and where a score doubles."""

    report_above: Number = param(
        "Lowest score that raises an alert; 1 is the default threshold of the detector. A lower value records what "
        "lower thresholds would find.",
        default=1.0, ge=1e-3, le=1e3,
    )  # fmt: skip
    quiet_s: Number = param(
        "Time without such a score after which the next one is a new episode, in seconds.",
        default=5.0, ge=0.0, le=3600.0,
    )  # fmt: skip
    episodes: Episodes

    def assemble(self, context: DetectorContext) -> Monitor:
        """See `Detector`."""
        self.episodes = Episodes(self.report_above, self.quiet_s)
        return super().assemble(context)
