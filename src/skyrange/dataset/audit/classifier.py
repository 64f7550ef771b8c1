"""Findings of an audit: whether columns that must not tell the arm of a run tell it nevertheless.

Arms that are equal in every block pass, whatever their number: nothing tells them apart. Where runs repeat to the byte
all other arms leak. Of other runs a classifier learns the arm on some blocks and is tested on others. A
comparison passes if the upper end of the interval of its AUC is at most 0.55; otherwise the columns are named without
which the classifier does worse. The interval is at least as wide as the exact one of a proportion of so many blocks: a
column that tells the arm in a fifth of them is easily in none of a few.

Up to the onset all arms of a block are one flight, and up to the first answer a sham has the shape of its attack. Of
runs that repeat to the byte every difference is a leak, be it in one block: a classifier of few blocks misses it. Of
other runs arms differ by chance, so a column leaks if the attacked arm is above the others, or below, in more blocks
than chance explains.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError, Problem
from skyrange.core.extras import missing_module
from skyrange.statistics.exact_intervals import proportion_interval
from skyrange.statistics.means import CONFIDENCE, LEVEL, adjust_by_holm, sign_test

ROWS: Final = "number of rows"
"""The name by which arms with different numbers of rows are told."""


def count_differences(
    columns: Sequence[str], values: Floats, attacked: NDArray[np.bool_], blocks: Sequence[str], runs: Sequence[str]
) -> dict[str, int]:
    """By column, the number of blocks in which an attacked run differs from another one of the block, the most first.

    `values` (n, k) are those of the rows, not-a-number where there is none; rows of a run are in the order in which
    they are compared. Columns that never differ are not among them.
    """
    differing_blocks: dict[str, int] = {}
    for rows in _by_name(blocks).values():
        places_by_run = _by_name([runs[row] for row in rows])
        parts = {run: np.array(rows)[places] for run, places in places_by_run.items()}
        hostile = [part for part in parts.values() if attacked[part[0]]]
        others = [part for part in parts.values() if not attacked[part[0]]]
        differing: set[str] = set()
        for attacked_rows in hostile:
            for other in others:
                if len(attacked_rows) != len(other):
                    differing.add(ROWS)
                    continue
                attacked_values, other_values = values[attacked_rows], values[other]
                unequal = (
                    (attacked_values != other_values) & ~(np.isnan(attacked_values) & np.isnan(other_values))
                ).any(axis=0)
                differing |= {columns[place] for place in np.flatnonzero(unequal).tolist()}
        for name in differing:
            differing_blocks[name] = differing_blocks.get(name, 0) + 1
    return dict(sorted(differing_blocks.items(), key=lambda counted: (-counted[1], counted[0])))


def find_shifted_columns(
    columns: Sequence[str], values: Floats, attacked: NDArray[np.bool_], blocks: Sequence[str]
) -> list[str]:
    """The columns whose mean over the attacked rows of a block is above that of the others, or below, in too many
    blocks for chance: by sign tests, adjusted for the number of columns.
    """
    signs = []
    for rows in _by_name(blocks).values():
        in_block = np.array(rows)
        attacked_values, other_values = values[in_block[attacked[in_block]]], values[in_block[~attacked[in_block]]]
        if len(attacked_values) and len(other_values):
            signs.append(np.sign(_means(attacked_values) - _means(other_values)))
    if not signs:
        return []
    above, below = ((np.array(signs) * sign > 0).sum(axis=0) for sign in (1, -1))
    p_values = [
        min(1.0, 2.0 * sign_test(int(max(up, down)), int(up + down))) if up + down else 1.0
        for up, down in zip(above.tolist(), below.tolist(), strict=True)
    ]
    adjusted = adjust_by_holm(p_values)
    return [name for p, name in sorted(zip(adjusted, columns, strict=True)) if p <= LEVEL]


def _means(values: Floats) -> Floats:
    """(k,) the means of (n, k) values without those that are not numbers; 0 without any."""
    known = ~np.isnan(values)
    means: Floats = np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return means


def _by_name(names: Sequence[str]) -> Mapping[str, list[int]]:
    places: dict[str, list[int]] = {}
    for place, name in enumerate(names):
        places.setdefault(name, []).append(place)
    return places


LIMIT: Final = 0.55
"""The largest upper end of an AUC's interval that passes."""
CHANCE: Final = 0.5
"""The AUC of a classifier that knows nothing."""
Status = Literal["passed", "leaks", "too few blocks"]
TOO_FEW: Final = "too few blocks"
MIN_BLOCKS: Final = 10
"""With fewer blocks an interval by blocks means nothing, and the comparison does not pass."""
MAX_ROWS: Final = 20_000
FOLDS: Final = 5
RESAMPLES: Final = 500
_WIDER: Final = math.sqrt(1.0 + FOLDS * 1.0 / (FOLDS - 1))
"""Resampling of tested rows leaves out that classifiers vary with their training rows, which folds share. The factor of
the interval is that of Nadeau & Bengio, "Inference for the Generalization Error", Machine Learning 52 (2003).
"""
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
    runs: Sequence[str] = ()
    """(n,) the run of each row; rows of a run are in an order that is the same in all arms. None: a row is a run."""
    repeats: bool = False
    """Whether the runs repeat to the byte, so that every difference is a leak."""
    exempt: Sequence[str] = ()
    """What was left out: attack kinds by name, because they are changes of timing, and how many runs of another setting
    than the others of their blocks.
    """


@dataclass(frozen=True, slots=True)
class LeakFinding:
    """What the audit has found in one comparison."""

    name: str
    rows: int
    blocks: int
    """With both arms."""
    auc: float | None
    """Out of fold, over all rows; 0.5 is chance. None if there are too few blocks for one, or none is needed."""
    low: float | None
    high: float | None
    """The 95 % interval: by resampling of blocks, widened for what the training rows contribute, and at least as wide
    as that of a proportion of as many blocks.
    """
    leaks: Sequence[str] = field(default=())
    """Columns that tell the arm, the strongest first; of columns that tell the same, perhaps only some."""
    exempt: Sequence[str] = field(default=())
    blocks_needed: int | None = None
    """Of a comparison that is not decided, about how many blocks with both arms may decide it."""
    differing: Mapping[str, int] | None = field(default=None)
    """Of runs that repeat to the byte, and of arms that are equal: by column, in how many blocks arms differ."""

    @property
    def status(self) -> Status:
        """passed: the arms are equal, or the upper end of the interval is at most 0.55. leaks: columns tell the arm.
        too few blocks: the interval is so wide that it has chance in it and more than 0.55; or there is none.
        """
        if self.leaks:
            return "leaks"
        if self.differing is not None:
            return "passed"
        if self.low is None or self.high is None:
            return TOO_FEW
        return "passed" if self.high <= LIMIT else "leaks" if self.low > CHANCE else TOO_FEW

    @property
    def passed(self) -> bool:
        """Whether there are blocks enough, and no classifier did better than the limit allows."""
        return self.status == "passed"


def audit_comparison(comparison: Comparison, seed: int = 0) -> LeakFinding:
    """Train, test and interpret a classifier of one comparison.

    The same input gives the same finding. Columns are named if they leak. At most `MAX_ROWS` rows are used, of whole
    blocks. Raises `InputError` if scikit-learn is not installed.
    """
    values, attacked = comparison.values, comparison.attacked
    numbers = _number_blocks(comparison.blocks)
    has_both = np.isin(numbers, np.intersect1d(numbers[attacked], numbers[~attacked]))
    values, attacked, numbers = values[has_both], attacked[has_both], _number_blocks(numbers[has_both])
    if len(values) and (known := _compare_arms(comparison, has_both)) is not None:
        return known
    generator = np.random.default_rng(seed)
    kept = _whole_blocks(numbers, generator)
    values, attacked, numbers = values[kept], attacked[kept], _number_blocks(numbers[kept])
    count = int(numbers.max()) + 1 if len(numbers) else 0
    if count < MIN_BLOCKS:
        few = (None, None, None, (), comparison.exempt, least_blocks())
        return LeakFinding(comparison.name, len(attacked), count, *few)
    rows = _Rows(_ranks(values), attacked, numbers, _weights(attacked, numbers))
    scores, models = _out_of_fold(rows, seed)
    auc = weighted_auc(scores, attacked, rows.weights)
    draws = generator.multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES)
    resampled = [weighted_auc(scores, attacked, draw[numbers] * rows.weights) for draw in draws]
    low, high = (float(end) for end in np.clip(auc + _WIDER * (np.nanquantile(resampled, [0.025, 0.975]) - auc), 0, 1))
    # of few blocks classifiers do worse than chance on those left out, which says nothing against a leak
    low = min(low, proportion_interval(auc * count, count, CONFIDENCE)[0])
    high = max(high, proportion_interval(max(auc, CHANCE) * count, count, CONFIDENCE)[1])
    finding = LeakFinding(comparison.name, len(attacked), count, auc, low, high, (), comparison.exempt)
    shifted = find_shifted_columns(comparison.columns, values, attacked, [str(number) for number in numbers.tolist()])
    leaking = _leaking_columns(comparison.columns, rows, models, auc, generator) if low > CHANCE else ()
    if shifted or leaking:
        return replace(finding, leaks=tuple(dict.fromkeys([*leaking, *shifted])))
    return (
        finding if finding.passed else replace(finding, blocks_needed=_estimate_blocks(finding.blocks, auc, low, high))
    )


def _compare_arms(comparison: Comparison, has_both: NDArray[np.bool_]) -> LeakFinding | None:
    """What follows from the rows alone: that arms are equal, or of runs that repeat to the byte, by what they differ;
    `None` if chance may explain it.
    """
    kept = np.flatnonzero(has_both).tolist()
    blocks = [comparison.blocks[row] for row in kept]
    given = comparison.runs or [str(row) for row in range(len(comparison.blocks))]
    runs = [given[row] for row in kept]
    differing = count_differences(
        comparison.columns, comparison.values[has_both], comparison.attacked[has_both], blocks, runs
    )
    if differing and not comparison.repeats:
        return None
    count = len(set(blocks))
    return LeakFinding(
        comparison.name, len(kept), count, None, None, None, tuple(differing), comparison.exempt, None, differing
    )


def _estimate_blocks(blocks: int, auc: float, low: float, high: float) -> int:
    """About how many blocks make an interval that lies below the limit or above chance, whichever is nearer: its width
    is that of the root of their number.
    """
    margin = max(LIMIT - max(auc, CHANCE), auc - CHANCE)
    return max(least_blocks(), blocks + 1, math.ceil(blocks * ((high - low) / 2.0 / margin) ** 2))


@cache
def least_blocks() -> int:
    """The fewest blocks with which an AUC of chance passes, by the exact interval."""

    def passes(blocks: int) -> bool:
        return proportion_interval(CHANCE * blocks, blocks, CONFIDENCE)[1] <= LIMIT

    few, enough = MIN_BLOCKS, 10 * MIN_BLOCKS
    while not passes(enough):
        few, enough = enough, 2 * enough
    while enough - few > 1:
        middle = (few + enough) // 2
        few, enough = (few, middle) if passes(middle) else (middle, enough)
    return enough


def require_no_leak(findings: Sequence[LeakFinding]) -> None:
    """Raise `InputError` with every comparison that does not pass: the columns that leak, or that there are too few
    blocks to say.
    """
    problems = []
    for finding in findings:
        interval = "" if finding.auc is None else f"AUC {finding.auc:.2f} ({finding.low:.2f} to {finding.high:.2f})"
        if finding.differing:
            counts = ", ".join(
                f"{name} in {count} of {finding.blocks} blocks" for name, count in finding.differing.items()
            )
            problems.append(
                Problem(finding.name, f"leaks: arms differ by {counts}", "arms that are equal in every block")
            )
        elif finding.differing is not None and finding.leaks:
            problems.append(
                Problem(finding.name, f"leaks: {', '.join(finding.leaks)}", "nothing that is in two splits")
            )
        elif finding.status == "leaks":
            expected = f"an upper end of at most {LIMIT}"
            problems.append(Problem(finding.name, f"leaks: {interval} by {', '.join(finding.leaks)}", expected))
        elif finding.status == TOO_FEW:
            shortage = f"too few blocks: {finding.blocks} with both arms{interval and ', '}{interval}"
            problems.append(
                Problem(finding.name, shortage, f"about {finding.blocks_needed} blocks, to tell a leak from chance")
            )
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


class _Rows(NamedTuple):
    """What a classifier learns and is tested on, one entry for each row."""

    values: Floats
    attacked: NDArray[np.bool_]
    numbers: Ints
    """Of their blocks, from 0."""
    weights: Floats


def _number_blocks(blocks: Sequence[str] | Ints) -> Ints:
    return np.unique(np.asarray(blocks), return_inverse=True)[1].astype(np.int64)


def _weights(attacked: NDArray[np.bool_], numbers: Ints) -> Floats:
    """(n,) weights by which both classes have 1 in each block: the number of its arms tells the block, and no arm."""
    cells = numbers * 2 + attacked
    weights: Floats = 1.0 / np.bincount(cells)[cells]
    return weights


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


def _out_of_fold(rows: _Rows, seed: int) -> tuple[Floats, list[_Model]]:
    """(n,) the score of each row by a classifier that has not seen its block, and the classifiers."""
    try:
        from sklearn.ensemble import RandomForestClassifier
    except ImportError as error:
        raise missing_module("sklearn", "study", "dataset audit") from error
    scores = np.empty(len(rows.values))
    models: list[_Model] = []
    leaf = max(2, min(20, len(rows.values) // 40))
    for fold in range(FOLDS):
        tested = np.flatnonzero(rows.numbers % FOLDS == fold)
        trained = rows.numbers % FOLDS != fold
        model = RandomForestClassifier(
            n_estimators=TREES, min_samples_leaf=leaf, bootstrap=False, random_state=seed, n_jobs=1
        )
        model.fit(rows.values[trained], rows.attacked[trained], rows.weights[trained])
        scores[tested] = model.predict_proba(rows.values[tested])[:, 1]
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
    names: Sequence[str], rows: _Rows, models: Sequence[_Model], auc: float, generator: np.random.Generator
) -> tuple[str, ...]:
    """The columns whose permutation among the tested rows costs AUC, the most costly first."""
    losses = []
    for place, name in enumerate(names):
        scores = np.empty(len(rows.values))
        for model, tested in models:
            shuffled = rows.values[tested].copy()
            shuffled[:, place] = generator.permutation(shuffled[:, place])
            scores[tested] = _midranks(model.predict_proba(shuffled)[:, 1])
        losses.append((auc - weighted_auc(scores, rows.attacked, rows.weights), name))
    losses.sort(key=lambda candidate: (-candidate[0], candidate[1]))
    named = tuple(name for loss, name in losses if loss >= max(NAMED_FROM, losses[0][0] * NAMED_SHARE))
    return named or _telling_alone(names, rows)


def _telling_alone(names: Sequence[str], rows: _Rows) -> tuple[str, ...]:
    """The columns that tell the arm best on their own, where several tell the same and none is missed."""
    alone = [abs(weighted_auc(column, rows.attacked, rows.weights) - CHANCE) for column in rows.values.T]
    return tuple(name for name, gain in zip(names, alone, strict=True) if gain >= max(alone) - NAMED_FROM)
