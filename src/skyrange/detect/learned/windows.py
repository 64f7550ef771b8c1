"""Learned detector: a trained model over the features of each window of each aircraft's link.

`skyrange study score` writes the file of the model into the folder `models` of the study, and beside it a model card,
which tells what the model was trained on and how well it did. The baselines are an isolation forest, which learns
nominal flights alone, and gradient-boosted trees, which learn attacks by their labels.

It cannot be expected to find attacks of a kind that it was not trained on, nor to be quiet in scenarios that differ
from those of its training: the scores on held-out families, cities and fleet sizes tell how far it holds.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import skyrange.plugin as sky
from skyrange.core.files import expand_user
from skyrange.detect.bases.windows import WindowDetector
from skyrange.detect.learned.model_file import Model, read_model
from skyrange.detect.series import Floats


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
                replace(one, where="file" if one.where == "file" else f"file.{one.where}") for one in error.problems
            ]
            raise sky.InputError("detector", problems) from error
        self.service_ns = self.model.file.window_ns

    def score(self, features: Floats) -> Floats:
        """The odds over the model's threshold."""
        return self.model.score(features)


@cache
def _load(path: Path, _changed: int) -> Model:
    return Model(read_model(path))
