"""Verdicts over many cells: how often a defence is said to stop an attack that it does not stop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy import stats

from skyrange.statistics.means import (
    LEVEL,
    adjust_by_holm,
    pairs_needed,
    share_test,
    sign_test,
)
from skyrange.study.matrix.cells import Cell
from skyrange.study.matrix.model import UNDEFENDED
from skyrange.study.matrix.verdicts import judge_cells
from tests.validation.inference_samples import margin

REPLICATES = [80, pytest.param(2_000, marks=pytest.mark.slow)]


def cell(column: str, effects: Sequence[float], complete: Sequence[bool] | None = None, growth: float = 0.0) -> Cell:
    kept = [True] * len(effects) if complete is None else complete
    return Cell("row", column, effects=effects, complete=kept, growth_m_per_min=[growth] * len(effects),
                alarms_s=[None] * len(effects), watched_s=[60.0] * len(effects))  # fmt: skip


@pytest.mark.parametrize("replicates", REPLICATES)
@pytest.mark.parametrize("seeds", [5, 12, 20])
@pytest.mark.parametrize("spread", ["normal", "lognormal", "half fail"])
def test_of_88_cells_with_half_of_the_harm_left_none_is_called_stopped(
    seeds: int, spread: str, replicates: int
) -> None:
    """Every defence leaves half of the harm: by a little noise, by a lot, or none in half of the flights."""
    chance = np.random.default_rng(4)
    false = 0
    for _ in range(replicates // 4):
        columns = {
            "normal": chance.normal(25.0, 5.0, (88, seeds)),
            "lognormal": 25.0 * chance.lognormal(0.0, 1.0, (88, seeds)),
            "half fail": 50.0 * (chance.random((88, seeds)) < 0.5),
        }[spread]
        cells = {("row", UNDEFENDED): cell(UNDEFENDED, [50.0] * seeds)}
        cells |= {("row", f"c{k}"): cell(f"c{k}", own.tolist()) for k, own in enumerate(columns)}
        false += any(one.stops for one in judge_cells(cells).of.values())
    assert false / (replicates // 4) <= LEVEL + margin(LEVEL, replicates // 4)


@pytest.mark.slow
def test_cells_that_lose_harm_or_missions_alone_are_together_no_more_often_called_stopped() -> None:
    """Twenty cells leave half of the harm, twenty others lose half of the missions, with many seeds."""
    chance, false, replicates, seeds = np.random.default_rng(9), 0, 400, 201
    for _ in range(replicates):
        cells = {("row", UNDEFENDED): cell(UNDEFENDED, [50.0] * seeds)}
        for k in range(20):
            cells["row", f"h{k}"] = cell(f"h{k}", (50.0 * (chance.random(seeds) < 0.5)).tolist())
            cells["row", f"m{k}"] = cell(f"m{k}", [0.0] * seeds, (chance.random(seeds) < 0.5).tolist())
        false += any(one.stops for one in judge_cells(cells).of.values())
    assert false / replicates <= LEVEL + margin(LEVEL, replicates)


def test_a_defence_that_always_works_is_shown_with_seeds_enough_and_marked_before() -> None:
    for seeds, shown in ((5, False), (10, False), (11, True)):
        cells = {("row", UNDEFENDED): cell(UNDEFENDED, [50.0 + k for k in range(seeds)])}
        cells |= {("row", f"c{k}"): cell(f"c{k}", [0.1] * seeds) for k in range(88)}
        verdicts = judge_cells(cells)
        assert verdicts.seeds_needed == 11
        assert verdicts.stops("row", "c3") == shown
        assert verdicts.in_every_flight("row", "c3")


def test_a_defence_that_breaks_missions_or_lets_the_harm_grow_does_not_stop_it() -> None:
    seeds = 20
    cells = {
        ("row", UNDEFENDED): cell(UNDEFENDED, [50.0] * seeds, growth=13.0),
        ("row", "stops"): cell("stops", [1.0] * seeds),
        ("row", "breaks"): cell("breaks", [1.0] * seeds, [False] * seeds),
        ("row", "grows"): cell("grows", [20.0] * seeds, growth=13.0),
    }
    verdicts = judge_cells(cells)
    assert verdicts.stops("row", "stops")
    assert not verdicts.stops("row", "breaks")
    assert not verdicts.stops("row", "grows")
    assert verdicts.of["row", "grows", False].harm_p < LEVEL


@pytest.mark.parametrize("replicates", REPLICATES)
def test_the_effect_of_the_candidate_that_an_adversary_chooses_is_not_biased(replicates: int) -> None:
    """Eight candidates with the same true effect of 20: the largest mean of them is more, the reported one is not."""
    chance = np.random.default_rng(5)
    reported, largest = [], []
    for _ in range(replicates):
        draws = chance.normal(20.0, 8.0, (9, 6))
        own = Cell("row", "column", effects=draws[0].tolist(), complete=[True] * 6)
        tried = tuple(Cell("row", "column", effects=one.tolist(), complete=[True] * 6) for one in draws[1:])
        best = Cell("row", "column", effects=own.effects, complete=own.complete, adaptive=tried).best_adaptive
        assert best is not None
        assert len(best.effects) == 3
        reported.append(np.mean(best.effects))
        largest.append(draws.mean(axis=1).max())
    assert np.mean(reported) == pytest.approx(20.0, abs=3.3 * 8.0 / np.sqrt(3 * replicates))
    assert np.mean(largest) > 22.0


def test_p_values_are_those_of_scipy() -> None:
    mine, other = [1.0, 2.0, 4.0, 1.5, 0.2, 30.0], [10.0, 9.0, 11.0, 12.0, 8.0, 10.0]
    differences = np.array(mine) - 0.5 * np.array(other)
    signs = stats.binomtest(5, 6, 0.5, alternative="greater").pvalue
    t = stats.ttest_1samp(differences, 0.0, alternative="less").pvalue
    assert sign_test(5, 6) == pytest.approx(signs)
    assert share_test(mine, other, 0.5) == pytest.approx(max(signs, t))
    assert share_test([], [], 0.5) == 1.0
    assert adjust_by_holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert [pairs_needed(tests) for tests in (1, 44, 88)] == [5, 10, 11]
