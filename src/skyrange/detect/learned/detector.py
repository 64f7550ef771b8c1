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

import numpy as np
from pydantic import Field

from skyrange.contracts.alerts import Alert
from skyrange.contracts.detectors import DetectorContext, DetectorPlugin
from skyrange.contracts.monitors import Monitor, ObservedFrames
from skyrange.contracts.params import Number, Params
from skyrange.core.errors import InputError
from skyrange.core.input_files import expand_user
from skyrange.core.time import Time
from skyrange.detect.episodes import subject_of_link
from skyrange.detect.learned.features import WindowFeatures
from skyrange.detect.learned.model_file import Model, read_model

KIND = "learned.windows"
ABOUT = "Scores the features of each window of a link with a trained model."


class LearnedParams(Params):
    """Parameters of the learned detector."""

    file: str = Field(
        min_length=1,
        description="File of the model, such as studies/detectors/models/gradient-boosting.json; a relative one is "
        "relative to the scenario's file.",
    )
    report_above: Number = Field(
        default=1.0,
        ge=0.0,
        le=1e3,
        description="Windows with a score above it raise an alert; 1 is the threshold of the model.",
    )


class LearnedDetector:
    """A `skyrange.contracts.monitors.Monitor`: an alert for each window whose score is above `report_above`.

    A score is the odds that the model gives over its threshold. The subject of an alert is the owner of the link.
    Windows in which nothing arrived at an end are not scored.
    """

    def __init__(self, model: Model, report_above: float) -> None:
        self.service_ns: Time = model.file.window_ns
        self._model = model
        self._least = report_above
        self._features = WindowFeatures(self.service_ns)

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Score the window that ends now."""
        features = self._features.read(frames)
        rows = np.flatnonzero(np.bincount(frames.places[frames.received], minlength=len(features)) > 0)
        links = [frames.ports[row].link for row in rows.tolist()]
        scores = self._model.score(features[rows]).tolist()
        return [
            Alert(now, subject_of_link(link), KIND, score, {"link": link})
            for link, score in zip(links, scores, strict=True)
            if score > self._least
        ]


def make_learned(params: LearnedParams, context: DetectorContext | None = None) -> Monitor:
    """A new detector. Raises `InputError` for a file that holds no model."""
    path = expand_user(params.file).absolute()
    try:
        model = _load(path, path.stat().st_mtime_ns if path.is_file() else 0)
    except InputError as error:
        problems = [
            replace(one, where="file" if one.where == "file" else f"file.{one.where}") for one in error.problems
        ]
        raise InputError("detector", problems) from error
    return LearnedDetector(model, params.report_above)


@cache
def _load(path: Path, _changed: int) -> Model:
    return Model(read_model(path))


LEARNED = DetectorPlugin(LearnedParams, make_learned, ABOUT)
