"""Training of the learned baselines: an isolation forest by scikit-learn, gradient-boosted trees by LightGBM.

Both are trained with fixed settings, on one thread and with a seed, so that equal windows give equal models.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.core.extras import missing_module
from skyrange.detect.learned.model_file import (
    GRADIENT_BOOSTING,
    ISOLATION_FOREST,
    LEAF,
    Algorithm,
    ModelFile,
    TreeTable,
    mean_path,
)
from skyrange.detect.series import Floats
from skyrange.detect.window_features import NAMES
from skyrange.study.feature_windows import ATTACKED, BENIGN

FOREST_SETTINGS: Final[Mapping[str, Any]] = {"n_estimators": 200, "max_samples": 256, "n_jobs": 1}
"""256 samples and 100 trees suffice in Liu, Ting and Zhou (2008), section 4; twice the trees are steadier."""
BOOSTING_SETTINGS: Final[Mapping[str, Any]] = {
    "n_estimators": 150,
    "learning_rate": 0.05,
    "num_leaves": 15,
    "min_child_samples": 20,
    "subsample": 0.8,
    "subsample_freq": 1,
    "colsample_bytree": 0.8,
    "deterministic": True,
    "force_row_wise": True,
    "n_jobs": 1,
    "verbose": -1,
}
"""Fewer leaves than LightGBM's default of 31, and a part of rows and features for each tree: a study has few blocks."""
_LEAST_WINDOWS: Final = 50


def train(
    algorithm: Algorithm, features: Floats, labels: NDArray[np.int64], nominal: NDArray[np.bool_], seed: int,
    window_s: float,
) -> ModelFile:  # fmt: skip
    """A model with threshold 1, trained on (n, features) windows.

    `labels` are those of `label_windows`. An isolation forest is trained on benign windows of `nominal` runs alone,
    gradient boosting on all benign and attacked windows. Raises `InputError` with fewer than 50 windows of a class, and
    if a library is missing.
    """
    benign, attacked = labels == BENIGN, labels == ATTACKED
    if algorithm == ISOLATION_FOREST:
        used = benign & nominal
        _require(algorithm, "nominal", int(used.sum()))
        return _train_forest(features[used], seed, window_s)
    _require(algorithm, "benign", int(benign.sum()))
    _require(algorithm, "attacked", int(attacked.sum()))
    used = benign | attacked
    return _train_boosting(features[used], attacked[used], seed, window_s)


def _require(algorithm: str, kind: str, count: int) -> None:
    if count < _LEAST_WINDOWS:
        expected = f"at least {_LEAST_WINDOWS} {kind} windows in the training blocks"
        raise InputError.one("study", f"learned {algorithm}", f"{count} windows", expected, "Fly more seeds.")


def _train_forest(features: Floats, seed: int, window_s: float) -> ModelFile:
    try:
        from sklearn.ensemble import IsolationForest
    except ImportError as error:
        raise missing_module("sklearn", "study", "study") from error
    known = np.where(np.isfinite(features), features, np.nan)
    empty = np.isnan(known).all(axis=0)
    fill = np.where(empty, 0.0, np.nanmedian(np.where(empty, 0.0, known), axis=0))
    values = np.where(np.isnan(known), fill, known)
    settings = {**FOREST_SETTINGS, "max_samples": min(FOREST_SETTINGS["max_samples"], len(values))}
    forest = IsolationForest(**settings, random_state=seed % 2**32).fit(values.astype(np.float32))
    columns: dict[str, list[Any]] = {name: [] for name in TreeTable.model_fields}
    for tree, chosen in zip(forest.estimators_, forest.estimators_features_, strict=True):
        nodes, first = tree.tree_, len(columns["feature"])
        columns["roots"].append(first)
        leaf = nodes.children_left < 0
        depth = _depths(nodes.children_left, nodes.children_right) + mean_path(nodes.n_node_samples)
        columns["feature"] += np.where(leaf, LEAF, chosen[np.maximum(nodes.feature, 0)]).tolist()
        columns["threshold"] += np.where(leaf, 0.0, nodes.threshold).tolist()
        columns["left"] += np.where(leaf, LEAF, nodes.children_left + first).tolist()
        columns["right"] += np.where(leaf, LEAF, nodes.children_right + first).tolist()
        columns["missing_left"] += [False] * len(leaf)
        columns["value"] += np.where(leaf, depth, 0.0).tolist()
    training = {"library": f"scikit-learn {version('scikit-learn')}", "settings": settings, "seed": seed}
    return ModelFile(
        algorithm=ISOLATION_FOREST,
        window_s=window_s,
        features=NAMES,
        fill=tuple(fill.tolist()),
        samples=int(forest.max_samples_),
        threshold=1.0,
        training={**training, "nominal_windows": len(features)},
        trees=TreeTable.model_validate(columns),
    )


def _depths(left: NDArray[np.int64], right: NDArray[np.int64]) -> Floats:
    depth = np.zeros(len(left))
    for node in range(len(left)):  # parents come first
        if left[node] >= 0:
            depth[left[node]] = depth[right[node]] = depth[node] + 1.0
    return depth


def _train_boosting(features: Floats, attacked: NDArray[np.bool_], seed: int, window_s: float) -> ModelFile:
    try:
        import lightgbm
    except ImportError as error:
        raise missing_module("lightgbm", "study", "study") from error
    values = np.where(np.isfinite(features), features, np.nan)
    model = lightgbm.LGBMClassifier(**BOOSTING_SETTINGS, random_state=seed % 2**31).fit(values, attacked)
    columns: dict[str, list[Any]] = {name: [] for name in TreeTable.model_fields}
    for tree in model.booster_.dump_model()["tree_info"]:
        columns["roots"].append(len(columns["feature"]))
        _add_node(tree["tree_structure"], columns)
    gains = model.booster_.feature_importance("gain")
    training = {"library": f"lightgbm {version('lightgbm')}", "settings": dict(BOOSTING_SETTINGS), "seed": seed}
    shares = {name: round(float(gain / gains.sum()), 4) for name, gain in zip(NAMES, gains, strict=True) if gain > 0.0}
    return ModelFile(
        algorithm=GRADIENT_BOOSTING,
        window_s=window_s,
        features=NAMES,
        threshold=1.0,
        training={
            **training,
            "benign_windows": int((~attacked).sum()),
            "attacked_windows": int(attacked.sum()),
            "gain": dict(sorted(shares.items(), key=lambda item: -item[1])),
        },
        trees=TreeTable.model_validate(columns),
    )


def _add_node(node: Mapping[str, Any], columns: dict[str, list[Any]]) -> int:
    """Append a node of LightGBM's and those below it; returns its number."""
    number = len(columns["feature"])
    inner = "split_feature" in node
    threshold = float(node["threshold"]) if inner else 0.0
    columns["feature"].append(int(node["split_feature"]) if inner else LEAF)
    columns["threshold"].append(threshold)
    # without the missing type NaN LightGBM takes a missing value for 0
    missing_left = inner and (node["default_left"] if node["missing_type"] == "NaN" else threshold >= 0.0)
    columns["missing_left"].append(bool(missing_left))
    columns["value"].append(0.0 if inner else float(node["leaf_value"]))
    columns["left"].append(LEAF)
    columns["right"].append(LEAF)
    if inner:
        if node["decision_type"] != "<=":
            raise InputError.one("study", "learned", node["decision_type"], "splits of LightGBM by <=")
        columns["left"][number] = _add_node(node["left_child"], columns)
        columns["right"][number] = _add_node(node["right_child"], columns)
    return number
