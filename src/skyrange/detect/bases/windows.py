"""Base of detectors that score windows: features of all that was seen at a link end in a stretch of time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from skyrange.contracts.alerts import Alert
from skyrange.contracts.monitors import DetectorContext, Monitor, ObservedFrames
from skyrange.core.time import Time
from skyrange.detect.declaration import Detector
from skyrange.detect.series import Floats
from skyrange.detect.window_features import WindowFeatures


class WindowDetector(Detector):
    """Raises an alert for each window whose score is above a limit; a kind computes scores of the features.

    A window is as long as `service_ns`, which a kind may set in `prepare`. Windows in which nothing arrived at an end
    are not scored.
    """

    needs: ClassVar[tuple[str, ...]] = ("score",)

    report_above: float
    """The limit. A kind sets it, or has it as a parameter."""
    features: WindowFeatures

    def assemble(self, context: DetectorContext) -> Monitor:
        """See `Detector`."""
        made = super().assemble(context)
        self.features = WindowFeatures(self.service_ns)
        return made

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Score the window that ends now."""
        features = self.features.read(frames)
        rows = np.flatnonzero(np.bincount(frames.places[frames.received], minlength=len(features)) > 0)
        links = [frames.ports[row].link for row in rows.tolist()]
        scores = self.score(features[rows]).tolist()
        return [
            self.alert(now, link, score) for link, score in zip(links, scores, strict=True) if score > self.report_above
        ]

    def score(self, features: Floats) -> Floats:
        """(n,) scores of n windows; `features` are (n, features) in the order of `window_features.FEATURES`."""
        raise NotImplementedError
