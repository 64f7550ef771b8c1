"""Model file of a learned detector: JSON with the features, the threshold, the training, and the model itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skyrange.core.errors import InputError
from skyrange.core.files import MAX_RECORD_BYTES, atomic_write, read_input
from skyrange.core.time import Time, from_seconds
from skyrange.detect.episodes import MAX_SCORE
from skyrange.detect.learned.trees import Trees, TreeTable, boosting_odds, isolation_odds
from skyrange.detect.series import Floats
from skyrange.detect.window_features import NAMES

FORMAT: Final = "skyrange.model/1"
ISOLATION_FOREST: Final = "isolation_forest"
GRADIENT_BOOSTING: Final = "gradient_boosting"
Algorithm = Literal["isolation_forest", "gradient_boosting"]


class ModelFile(BaseModel):
    """A trained model. It holds numbers and text alone: to read one runs no code of its author."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    format: Literal["skyrange.model/1"] = Field(default=FORMAT, description="The format of this file.")
    algorithm: Algorithm = Field(description="The algorithm.")
    window_s: float = Field(gt=0, le=3600, description="Length of a window, in seconds.")
    features: tuple[str, ...] = Field(description="The features, in the order of the columns.")
    fill: tuple[float, ...] | None = Field(
        default=None,
        description="Values that stand for missing features, the medians of the training. Without, the trees have a "
        "branch for a missing value.",
    )
    samples: int = Field(default=0, ge=0, description="Windows of which each tree of an isolation forest was made.")
    threshold: float = Field(gt=0, description="The odds at which the score is 1.")
    training: dict[str, Any] = Field(default_factory=dict, description="What it was trained on, and with what.")
    trees: TreeTable = Field(description="The trees.")

    @property
    def window_ns(self) -> Time:
        """The length of a window, in ns."""
        return from_seconds(self.window_s)


class Model:
    """A trained model in memory."""

    def __init__(self, file: ModelFile) -> None:
        """Raises `InputError` for a damaged model, and for one of other features."""
        if file.features != NAMES:
            hint = "Train it again with this version."
            raise InputError.one("model", "features", list(file.features), f"the features {list(NAMES)}", hint)
        if file.fill is not None and len(file.fill) != len(NAMES):
            raise InputError.one("model", "fill", f"{len(file.fill)} values", f"{len(NAMES)} values")
        if file.algorithm == ISOLATION_FOREST and file.samples < 2:
            raise InputError.one("model", "samples", file.samples, "at least 2, for an isolation forest")
        self.file = file
        self._trees = Trees(file.trees, len(NAMES))

    def predict(self, features: Floats) -> Floats:
        """(n,) the odds of an attack, or of an anomaly, of (n, features) windows, where NaN is a missing value."""
        values = np.where(np.isfinite(features), features, np.nan)
        if self.file.algorithm == GRADIENT_BOOSTING:
            return boosting_odds(self._trees.leaf_values(values))
        if self.file.fill is not None:
            values = np.where(np.isnan(values), np.array(self.file.fill), values)
        values = values.astype(np.float32).astype(np.float64)  # scikit-learn compares in single precision
        return isolation_odds(self._trees.leaf_values(values), self.file.samples)

    def score(self, features: Floats) -> Floats:
        """(n,) the odds over the model's threshold, at most `episodes.MAX_SCORE`."""
        return np.minimum(self.predict(features) / self.file.threshold, MAX_SCORE)

    def __deepcopy__(self, memo: dict[int, object]) -> Model:
        """It does not change: copies of a detector share it."""
        return self


def write_model(model: ModelFile, path: Path) -> None:
    """Write a model: the file is there as a whole or not at all."""
    with atomic_write(path) as file:
        file.write(model.model_dump_json(exclude_none=True).encode())


def read_model(path: Path) -> ModelFile:
    """The model in a file. Raises `InputError` for one that is missing, damaged or of another format."""
    data = read_input(path, "model", max_bytes=MAX_RECORD_BYTES, expected="a model of skyrange study score")
    try:
        return ModelFile.model_validate(json.loads(data))
    except (ValueError, ValidationError, RecursionError) as error:
        first = error.errors()[0] if isinstance(error, ValidationError) else {"loc": (), "msg": str(error)}
        where = ".".join(map(str, first["loc"])) or "file"
        raise InputError.one(f"model {path}", where, first["msg"], f"a model of the format {FORMAT}") from error
