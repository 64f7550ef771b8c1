"""Models of learned detectors: decision trees as arrays, and the JSON file with features, threshold and model.

Isolation forest: F. T. Liu, K. M. Ting, Z.-H. Zhou, "Isolation Forest", ICDM 2008, p. 413-422. The score is equation 2
there, s = 2^(-E(h) / c(n)), with the mean path length E(h) over the trees and the mean c(n) of an unsuccessful search
in a binary tree of n samples (equation 1). Its odds are s / (1 - s): 1 for a window that lies as deep as the average.

Gradient boosting: the sum of the leaves is the logarithm of the odds (J. H. Friedman, "Greedy function approximation: a
gradient boosting machine", Annals of Statistics 29 (2001), p. 1189-1232, algorithm 5).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from skyrange.contracts.frames import Ints
from skyrange.core import elementwise
from skyrange.core.errors import InputError
from skyrange.core.files import atomic_write
from skyrange.core.time import Time, from_seconds
from skyrange.core.typed_json import Int64, check_type, read_formatted
from skyrange.detect.episodes import MAX_SCORE
from skyrange.detect.series import Floats
from skyrange.detect.window_features import NAMES

LEAF: Final = -1
_EULER: Final = 0.577_215_664_901_532_9
_MOST_LOG_ODDS: Final = 30.0


class TreeTable(BaseModel):
    """The nodes of all trees, one after the other; each column has a value for each node but `roots`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    roots: tuple[Int64, ...] = Field(min_length=1, description="The root of each tree, a number of a node.")
    feature: tuple[Int64, ...] = Field(description="The feature that the node compares; -1 for a leaf.")
    threshold: tuple[float, ...] = Field(description="Windows up to this value go to the left.")
    left: tuple[Int64, ...] = Field(description="The left child, a later node; -1 for a leaf.")
    right: tuple[Int64, ...] = Field(description="The right child, a later node; -1 for a leaf.")
    missing_left: tuple[bool, ...] = Field(description="Whether windows without this feature go to the left.")
    value: tuple[float, ...] = Field(
        description="Of a leaf: in an isolation forest the path length, its depth and c(n) for the n windows that it "
        "holds; in gradient boosting its part of the log-odds. 0 for other nodes."
    )


class Trees:
    """The trees in memory, checked."""

    def __init__(self, table: TreeTable, features: int) -> None:
        """Raises `InputError` for nodes that do not fit together, or that compare more than `features` features."""
        self._roots = np.array(table.roots, dtype=np.int64)
        self._feature = np.array(table.feature, dtype=np.int64)
        self._threshold = np.array(table.threshold, dtype=np.float64)
        self._left, self._right = (np.array(column, dtype=np.int64) for column in (table.left, table.right))
        self._missing_left = np.array(table.missing_left, dtype=np.bool_)
        self._value = np.array(table.value, dtype=np.float64)
        if not self._fits(features):
            expected = "columns of the same length, and children that come after their parents"
            raise InputError.one("model", "trees", f"{len(self._feature)} nodes", expected)

    def leaf_values(self, features: Floats) -> Floats:
        """(n, trees) the value of the leaf that each of the (n, features) windows falls into; NaN: missing."""
        rows = np.arange(len(features))[:, None]
        nodes = np.broadcast_to(self._roots, (len(features), len(self._roots)))
        while (inner := self._feature[nodes] != LEAF).any():
            values = features[rows, np.where(inner, self._feature[nodes], 0)]
            is_left = np.where(np.isnan(values), self._missing_left[nodes], values <= self._threshold[nodes])
            nodes = np.where(inner, np.where(is_left, self._left[nodes], self._right[nodes]), nodes)
        return np.asarray(self._value[nodes])

    def _fits(self, features: int) -> bool:
        """Children come after their parents, so that every walk ends."""
        count = len(self._feature)
        columns = (self._threshold, self._left, self._right, self._missing_left, self._value)
        if any(len(column) != count for column in columns) or not _within(self._roots, 0, count):
            return False
        inner = np.flatnonzero(self._feature != LEAF)
        children = np.concatenate([self._left[inner], self._right[inner]])
        later = bool((children > np.tile(inner, 2)).all())
        return later and _within(children, 0, count) and _within(self._feature, LEAF, features)


def isolation_odds(path_lengths: Floats, samples: int) -> Floats:
    """(n,) the odds of an anomaly by (n, trees) path lengths in trees of `samples` windows."""
    score = elementwise.power(2.0, -path_lengths.mean(axis=1) / mean_path(np.array([samples]))[0])
    return np.asarray(score / np.maximum(1.0 - score, np.finfo(np.float64).tiny))


def boosting_odds(parts: Floats) -> Floats:
    """(n,) the odds of an attack by the (n, trees) parts of its log-odds."""
    return np.asarray(elementwise.exp(np.clip(parts.sum(axis=1), -_MOST_LOG_ODDS, _MOST_LOG_ODDS)))


def mean_path(counts: NDArray[np.int64]) -> Floats:
    """c(n), the mean path length of an unsuccessful search in a binary tree of (n,) counts; 0 for 1, 1 for 2."""
    n = np.maximum(counts, 3).astype(np.float64)
    long = 2.0 * (elementwise.log(n - 1.0) + _EULER) - 2.0 * (n - 1.0) / n
    return np.where(counts <= 1, 0.0, np.where(counts == 2, 1.0, long))


def _within(values: Ints, low: int, high: int) -> bool:
    return bool(((values >= low) & (values < high)).all())


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
    samples: int = Field(
        default=0, ge=0, lt=2**63, description="Windows of which each tree of an isolation forest was made."
    )
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
    who = f"model {path}"
    data = read_formatted(path, FORMAT, who, "file", remedy="train it again.")
    model: ModelFile = check_type(data, ModelFile, who, "file", hint="Train it again with this version.")
    return model
