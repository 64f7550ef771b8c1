"""Agreement of two engines: shares of decoded frames by cell, and which swapped model closes a gap."""

from __future__ import annotations

import math
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
BUILTIN: Final = EngineSetup("builtin")


@dataclass
class Comparison:
    """Results of all engines: for each cell its experiment and description, and the share that each setup decodes."""

    setups: list[EngineSetup]
    cells: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    shares: dict[str, list[float]] = field(default_factory=dict)
    """By title of a setup; NaN where it was not run, because the defaults agree there."""
    frames: list[int] = field(default_factory=list)
    losses: PairLosses | None = None

    @property
    def experiments(self) -> list[str]:
        """Their names, in the order in which they were run."""
        return list(dict.fromkeys(name for name, _ in self.cells))

    @property
    def engines(self) -> list[str]:
        """The engines that are compared with the builtin."""
        return [setup.engine for setup in self.setups[1:] if not setup.swap]

    def swaps_of(self, engine: str) -> list[EngineSetup]:
        """The setups of an engine in which models are swapped."""
        return [setup for setup in self.setups if setup.engine == engine and setup.swap]

    def select(self, experiment: str, title: str) -> NDArray[np.int64]:
        """Rows of the cells of an experiment that count for a setup: it or the builtin decodes part of the frames."""
        found = []
        for row, (name, _) in enumerate(self.cells):
            shares = self.shares[BUILTIN.title][row], self.shares[title][row]
            if name == experiment and any(PARTIAL[0] <= share <= PARTIAL[1] for share in shares):
                found.append(row)
        return np.array(found, dtype=np.int64)

    def differences(self, rows: NDArray[np.int64], title: str) -> Floats:
        """Share of a setup minus the builtin's, in these cells."""
        shares, mine = np.array(self.shares[title]), np.array(self.shares[BUILTIN.title])
        return np.asarray(shares[rows] - mine[rows])

    def agreeing(self, experiment: str, title: str) -> tuple[int, int]:
        """Cells that agree, and cells that count."""
        rows = self.select(experiment, title)
        return int((np.abs(self.differences(rows, title)) <= WITHIN).sum()), len(rows)

    def closed(self, experiment: str, setup: EngineSetup) -> tuple[int, int]:
        """Of the cells in which the defaults of an engine disagree, those in which `setup` agrees, and all of them."""
        rows = self.gaps(experiment, setup.engine)
        return int((np.abs(self.differences(rows, setup.title)) <= WITHIN).sum()), len(rows)

    def gaps(self, experiment: str, engine: str) -> NDArray[np.int64]:
        """Rows of the cells in which the defaults of an engine disagree with the builtin."""
        title = EngineSetup(engine).title
        rows = self.select(experiment, title)
        return rows[np.abs(self.differences(rows, title)) > WITHIN]

    def explained(self, experiment: str, engine: str) -> tuple[int, int]:
        """Cells that agree with the defaults of an engine or with one of its swaps, and cells that count."""
        rows = self.gaps(experiment, engine)
        closed = np.zeros(len(rows), dtype=bool)
        for setup in self.swaps_of(engine):
            closed |= np.abs(self.differences(rows, setup.title)) <= WITHIN
        agreeing, counting = self.agreeing(experiment, EngineSetup(engine).title)
        return agreeing + int(closed.sum()), counting

    def nearest(self, engine: str) -> list[float]:
        """Shares of an engine's defaults or, where these disagree, of that of its swaps which is nearest."""
        found = list(self.shares[EngineSetup(engine).title])
        mine = self.shares[BUILTIN.title]
        for experiment in self.experiments:
            for row in self.gaps(experiment, engine).tolist():
                swapped = [self.shares[setup.title][row] for setup in self.swaps_of(engine)]
                found[row] = min(
                    [found[row], *filter(math.isfinite, swapped)], key=lambda share: abs(share - mine[row])
                )
        return found


OnStep = Callable[[str, int, int], None]
"""Called with what is being done, steps done, and all steps."""


def compare(city: City, engines: Sequence[str], *, pairs: int = PAIRS, on_step: OnStep | None = None) -> Comparison:
    """Run all experiments with the builtin medium and with `engines`.

    Each engine runs with its defaults and, where these disagree with the builtin, with each of its swaps.
    """
    trials = [*reach_trials(city), *contention_trials(), *hidden_trials()]
    setups = [BUILTIN]
    for engine in engines:
        setups += [EngineSetup(engine), *SWAPS.get(engine, ())]
    result = Comparison(setups)
    for trial in trials:
        result.cells += [(trial.experiment, cell.facts) for cell in trial.cells]
    owner = np.repeat(np.arange(len(trials)), [len(trial.cells) for trial in trials])
    for setup in setups:
        chosen = set(range(len(trials)))
        if setup.swap:
            gaps = [result.gaps(experiment, setup.engine) for experiment in result.experiments]
            chosen = set(owner[np.concatenate(gaps)].tolist())
        result.shares[setup.title] = []
        for number, trial in enumerate(trials):
            if on_step is not None:
                on_step(f"{setup.title}: {trial.experiment}", number, len(trials))
            if number not in chosen:
                result.shares[setup.title] += [math.nan] * len(trial.cells)
                continue
            found = run_trial(trial, setup, city)
            result.shares[setup.title] += (found.decoded / found.offered).tolist()
            if setup is BUILTIN:
                result.frames += found.offered.tolist()
    result.losses = draw_pairs(city, pairs)
    models = [model for model in MODELS if model.engine in engines]
    for number, model in enumerate(models):
        if on_step is not None:
            on_step(f"{model.title}: losses of {pairs:,} pairs", number, len(models))
        add_model(result.losses, model, city)
    return result
