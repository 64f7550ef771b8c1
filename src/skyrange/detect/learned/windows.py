"""Learned detector: a trained model over the features of each window of each aircraft's link.

`skyrange study score` writes the file of the model into the folder `models` of the study, and beside it a model card,
which tells what the model was trained on and how well it did. The baselines are an isolation forest, which learns
nominal flights alone, and gradient-boosted trees, which learn attacks by their labels.

It cannot be expected to find attacks of a kind that it was not trained on, nor to be quiet in scenarios that differ
from those of its training: the scores on held-out families, cities and fleet sizes tell how far it holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np

import skyrange.plugin as sky
from skyrange.contracts.alerts import Alert
from skyrange.contracts.monitors import DetectorContext, Monitor, ObservedFrames
from skyrange.core.files import expand_user
from skyrange.core.time import Time
from skyrange.detect.declaration import Detector
from skyrange.detect.learned.model_file import Model, read_model
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


@sky.detector("learned.windows")
class LearnedWindows(WindowDetector):
    """Scores the features of each window of a link with a trained model.

    A score is the odds that the model gives over its threshold.
    """

    file: str = sky.param(
        "File of the model, such as studies/detectors/models/gradient-boosting.json; a relative one is relative to the "
        "scenario's file.",
        min_length=1,
    )
    report_above: sky.Number = sky.param(
        "Windows with a score above it raise an alert; 1 is the threshold of the model.", default=1.0, ge=0.0, le=1e3
    )
    model: Model

    def prepare(self, context: sky.DetectorContext) -> None:
        """Read the model. Raises `InputError` for a file that holds none."""
        path = expand_user(self.file).absolute()
        try:
            self.model = _load(path, path.stat().st_mtime_ns if path.is_file() else 0)
        except sky.InputError as error:
            problems = [
                replace(problem, where="file" if problem.where == "file" else f"file.{problem.where}")
                for problem in error.problems
            ]
            raise sky.InputError("detector", problems) from error
        self.service_ns = self.model.file.window_ns

    def score(self, features: Floats) -> Floats:
        """The odds over the model's threshold."""
        return self.model.score(features)


@cache
def _load(path: Path, _changed: int) -> Model:
    return Model(read_model(path))
