"""Agreement of two engines: shares of decoded frames by cell, and which swapped model closes a gap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from skyrange.study.compare.radio.experiments import contention_trials, hidden_trials, reach_trials
from skyrange.study.compare.radio.own_losses import MODELS, PAIRS, PairLosses, add_model, draw_pairs
from skyrange.study.compare.radio.setups import SWAPS, EngineSetup
from skyrange.study.compare.radio.trials import run_trial

Floats = NDArray[np.float64]

PARTIAL: Final = (0.05, 0.95)
"""A cell counts if either engine decodes a share in here: where both hear all or nothing, nothing is compared."""
WITHIN: Final = 0.05
"""Two shares agree if they differ by at most this."""
GOAL: Final = 0.9
"""Share of the cells that should agree."""
BUILTIN: Final = EngineSetup("builtin")


@dataclass
class Comparison:
    """Results of all engines: for each cell its experiment and description, and the share that each setup decodes."""

    setups: list[EngineSetup]
    cells: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    shares: dict[str, list[float]] = field(default_factory=dict)
    """By title of a setup."""
    frames: list[int] = field(default_factory=list)
    losses: PairLosses | None = None

    def select(self, experiment: str, first: str, second: str) -> tuple[NDArray[np.int64], Floats]:
        """Rows of the cells of an experiment in which either setup decodes part, and the differences there."""
        rows = [row for row, (name, _) in enumerate(self.cells) if name == experiment]
        one, other = (np.array([self.shares[title][row] for row in rows]) for title in (first, second))
        partial = ((one >= PARTIAL[0]) & (one <= PARTIAL[1])) | ((other >= PARTIAL[0]) & (other <= PARTIAL[1]))
        return np.array(rows, dtype=np.int64)[partial], (other - one)[partial]

    @property
    def experiments(self) -> list[str]:
        """Their names, in the order in which they were run."""
        return list(dict.fromkeys(name for name, _ in self.cells))

    def agreeing(self, experiment: str, first: str, second: str) -> tuple[int, int]:
        """Cells that agree, and cells that count."""
        _, difference = self.select(experiment, first, second)
        return int((np.abs(difference) <= WITHIN).sum()), len(difference)

    def explained(self, experiment: str, first: EngineSetup, second: EngineSetup) -> tuple[int, int]:
        """Cells that agree with the defaults of `second` or with one of its swaps, and cells that count."""
        rows, difference = self.select(experiment, first.title, second.title)
        good = np.abs(difference) <= WITHIN
        mine = np.array(self.shares[first.title])
        for setup in self.setups:
            if setup.engine == second.engine and setup.swap:
                good |= np.abs(np.array(self.shares[setup.title])[rows] - mine[rows]) <= WITHIN
        return int(good.sum()), len(rows)


OnStep = Callable[[str, int, int], None]
"""Called with what is being done, steps done, and all steps."""


def compare(
    city: City,
    engines: Sequence[str],
    *,
    swaps: bool = True,
    pairs: int = PAIRS,
    on_step: OnStep | None = None,
) -> Comparison:
    """Run all experiments with the builtin medium and with `engines`, each by default and with its swaps."""
    setups = [BUILTIN]
    for engine in engines:
        setups += [EngineSetup(engine), *(SWAPS.get(engine, ()) if swaps else ())]
    trials = [*reach_trials(city), *contention_trials(), *hidden_trials()]
    models = [model for model in MODELS if model.engine in engines]
    result = Comparison(setups, shares={setup.title: [] for setup in setups})
    for trial in trials:
        result.cells += [(trial.experiment, cell.facts) for cell in trial.cells]
    total, done = len(setups) * len(trials) + len(models) + 1, 0
    for setup in setups:
        for trial in trials:
            if on_step is not None:
                on_step(f"{setup.title}: {trial.experiment}", done, total)
            found = run_trial(trial, setup, city)
            result.shares[setup.title] += (found.decoded / found.offered).tolist()
            if setup is BUILTIN:
                result.frames += found.offered.tolist()
            done += 1
    result.losses = draw_pairs(city, pairs)
    for model in models:
        if on_step is not None:
            on_step(f"{model.title}: losses of {pairs:,} pairs", done, total)
        add_model(result.losses, model, city)
        done += 1
    return result
