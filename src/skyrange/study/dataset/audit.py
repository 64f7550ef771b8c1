"""Audit of a data set for leaks: whether columns that must not tell the arm of a run tell it nevertheless.

A classifier learns the arm on some blocks and is tested on others. A comparison passes if the upper end of the interval
of its AUC is at most 0.55; otherwise the columns are named without which the classifier does worse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError, Problem

LIMIT: Final = 0.55
"""The largest upper end of an AUC's interval that passes."""
MIN_BLOCKS: Final = 10
"""With fewer blocks an interval by blocks means nothing, and the comparison does not pass."""
MAX_ROWS: Final = 20_000
FOLDS: Final = 5
RESAMPLES: Final = 500
TREES: Final = 50
NAMED_FROM: Final = 0.01
"""The loss of AUC without a column from which it is named."""
NAMED_SHARE: Final = 0.2
"""The least loss of a named column, as a share of the largest: with few rows all columns lose a little by chance."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Rows of two arms, to be told apart by columns that should not allow it."""

    name: str
    columns: Sequence[str]
    values: Floats
    """(n, k); not-a-number where there is none."""
    attacked: NDArray[np.bool_]
    """(n,) whether a row is of the attacked arm."""
    blocks: Sequence[str]
    """(n,) the block of each row."""
    exempt: Sequence[str] = ()
    """Attack kinds that were left out by name, because they are changes of timing."""


@dataclass(frozen=True, slots=True)
class LeakFinding:
    """What the audit has found in one comparison."""

    name: str
    rows: int
    blocks: int
    auc: float
    """Out of fold, over all rows; 0.5 is chance."""
    low: float
    high: float
    """The 95 % interval, by resampling of blocks."""
    leaks: Sequence[str] = field(default=())
    """Columns that tell the arm, the strongest first; of columns that tell the same, perhaps only some."""
    exempt: Sequence[str] = field(default=())
    reason: str = ""
    """Why nothing could be decided; empty if it could."""

    @property
    def passed(self) -> bool:
        """Whether there are blocks enough, and no classifier did better than the limit allows."""
        return not self.reason and self.high <= LIMIT


def audit_comparison(comparison: Comparison, seed: int = 0) -> LeakFinding:
    """Train, test and interpret a classifier of one comparison.

    The same input gives the same finding. At most `MAX_ROWS` rows are used, of whole blocks. Raises `InputError` if
    scikit-learn is not installed.
    """
    numbers = np.unique(np.asarray(comparison.blocks, dtype=str), return_inverse=True)[1].astype(np.int64)
    values, attacked = comparison.values, comparison.attacked
    generator = np.random.default_rng(seed)
    kept = _whole_blocks(numbers, generator)
    values, attacked, numbers = values[kept], attacked[kept], np.unique(numbers[kept], return_inverse=True)[1]
    count = int(numbers.max()) + 1 if len(numbers) else 0
    both = sum(len({*attacked[numbers == block].tolist()}) == 2 for block in range(count))
    if both < MIN_BLOCKS:
        reason = f"{both} blocks have both arms; {MIN_BLOCKS} are needed"
        return LeakFinding(comparison.name, len(attacked), count, np.nan, np.nan, np.nan, (), comparison.exempt, reason)
    values = _ranks(values)
    scores, models = _out_of_fold(values, attacked, numbers, seed)
    auc = weighted_auc(scores, attacked, np.ones(len(scores)))
    draws = generator.multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES)
    resampled = [weighted_auc(scores, attacked, draw[numbers].astype(np.float64)) for draw in draws]
    low, high = np.nanquantile(resampled, [0.025, 0.975])
    leaks: tuple[str, ...] = ()
    if high > LIMIT:
        leaks = _leaking_columns(comparison.columns, values, attacked, models, auc, generator)
    return LeakFinding(comparison.name, len(attacked), count, auc, float(low), float(high), leaks, comparison.exempt)


def require_no_leak(findings: Sequence[LeakFinding]) -> None:
    """Raise `InputError` with every comparison that does not pass, and the columns that leak."""
    problems = []
    for one in findings:
        if not one.passed:
            what = one.reason or f"AUC {one.auc:.2f} ({one.low:.2f} to {one.high:.2f}) by {', '.join(one.leaks)}"
            problems.append(Problem(one.name, what, f"an upper end of at most {LIMIT}"))
    if problems:
        raise InputError("leak audit", problems)


def weighted_auc(scores: Floats, positive: NDArray[np.bool_], weights: Floats) -> float:
    """The area under the ROC curve of (n,) scores; ties count half. Not a number without weight in both classes."""
    order = np.argsort(scores, kind="stable")
    _, tie = np.unique(scores[order], return_inverse=True)
    for_, against = (np.bincount(tie, np.where(chosen, weights, 0.0)[order]) for chosen in (positive, ~positive))
    if not for_.sum() or not against.sum():
        return float("nan")
    below = np.cumsum(against) - against
    return float((for_ * (below + against / 2.0)).sum() / (for_.sum() * against.sum()))


def _whole_blocks(numbers: Ints, generator: np.random.Generator) -> Ints:
    """The rows of as many blocks, in an order by chance, as have `MAX_ROWS` rows together."""
    if len(numbers) <= MAX_ROWS:
        return np.arange(len(numbers))
    order = generator.permutation(int(numbers.max()) + 1)
    sizes = np.bincount(numbers)[order]
    chosen = order[: max(MIN_BLOCKS, int(np.searchsorted(np.cumsum(sizes), MAX_ROWS, side="right")))]
    return np.flatnonzero(np.isin(numbers, chosen))


def _ranks(values: Floats) -> Floats:
    """(n, k) the rank of each value in its column, that of not-a-number last. Trees compare in single precision, in
    which ranks are exact and values are not.
    """
    ranked = [np.unique(column, return_inverse=True)[1] for column in values.T]
    return np.column_stack(ranked).astype(np.float64)


_Model = tuple[Any, Ints]
"""A fitted classifier, and the rows on which it was tested."""


def _out_of_fold(values: Floats, attacked: NDArray[np.bool_], numbers: Ints, seed: int) -> tuple[Floats, list[_Model]]:
    """(n,) the score of each row by a classifier that has not seen its block, and the classifiers."""
    try:
        from sklearn.ensemble import RandomForestClassifier
    except ImportError as error:
        hint = "Install it with: pip install 'skyrange[study]'"
        raise InputError.one("dataset", "audit", "sklearn", "an installed package scikit-learn", hint) from error
    scores = np.empty(len(values))
    models: list[_Model] = []
    leaf = max(2, min(20, len(values) // 40))
    for fold in range(FOLDS):
        tested = np.flatnonzero(numbers % FOLDS == fold)
        trained = numbers % FOLDS != fold
        model = RandomForestClassifier(
            n_estimators=TREES, min_samples_leaf=leaf, bootstrap=False, random_state=seed, n_jobs=1
        )
        model.fit(values[trained], attacked[trained])
        scores[tested] = model.predict_proba(values[tested])[:, 1]
        models.append((model, tested))
    # scores of different classifiers are compared as ranks within their folds
    for _, tested in models:
        scores[tested] = _midranks(scores[tested])
    return scores, models


def _midranks(scores: Floats) -> Floats:
    """Ranks from 0 to 1; equal scores have the mean of their ranks."""
    _, place, counts = np.unique(np.round(scores, 12), return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    ranks: Floats = ((ends - counts / 2.0) / len(scores))[place]
    return ranks


def _leaking_columns(
    names: Sequence[str], values: Floats, attacked: NDArray[np.bool_], models: Sequence[_Model], auc: float,
    generator: np.random.Generator,
) -> tuple[str, ...]:  # fmt: skip
    """The columns whose permutation among the tested rows costs AUC, the most costly first."""
    losses = []
    for place, name in enumerate(names):
        scores = np.empty(len(values))
        for model, tested in models:
            shuffled = values[tested].copy()
            shuffled[:, place] = generator.permutation(shuffled[:, place])
            scores[tested] = _midranks(model.predict_proba(shuffled)[:, 1])
        losses.append((auc - weighted_auc(scores, attacked, np.ones(len(scores))), name))
    losses.sort(key=lambda one: (-one[0], one[1]))
    named = tuple(name for loss, name in losses if loss >= max(NAMED_FROM, losses[0][0] * NAMED_SHARE))
    return named or _telling_alone(names, values, attacked)


def _telling_alone(names: Sequence[str], values: Floats, attacked: NDArray[np.bool_]) -> tuple[str, ...]:
    """The columns that tell the arm best on their own, where several tell the same and none is missed."""
    alone = [abs(weighted_auc(column, attacked, np.ones(len(column))) - 0.5) for column in values.T]
    return tuple(name for name, gain in zip(names, alone, strict=True) if gain >= max(alone) - NAMED_FROM)
