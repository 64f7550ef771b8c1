"""Agreement of two engines: shares of decoded frames by cell, and which swapped models close a gap."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.city.city import City
from tools.agreement.radio.experiments import Trial, contention_trials, hidden_trials, reach_trials, run_trial
from tools.agreement.radio.own_losses import MODELS, PAIRS, PairLosses, add_model, draw_pairs
from tools.agreement.radio.setups import BUILTIN, SWAPS, EngineSetup, Swap

Floats = NDArray[np.float64]

PARTIAL: Final = (0.05, 0.95)
"""A cell counts if either engine decodes a share in here: where both hear all or nothing, nothing is compared."""
WITHIN: Final = 0.05
"""Two shares agree if they differ by at most this."""


@dataclass
class Comparison:
    """Results of all engines: for each cell its experiment and description, and the share that each setup decodes."""

    engines: Sequence[str]
    """The engines that are compared with the builtin."""
    swaps: Mapping[str, Sequence[Swap]]
    """By engine."""
    cells: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    shares: dict[str, list[float]] = field(default_factory=dict)
    """By title of a setup; NaN where it was not run, because all defaults agree there."""
    frames: list[int] = field(default_factory=list)
    losses: PairLosses | None = None

    @property
    def experiments(self) -> list[str]:
        """Their names, in the order in which they were run."""
        return list(dict.fromkeys(name for name, _ in self.cells))

    def select(self, experiment: str, title: str) -> NDArray[np.int64]:
        """Rows of the cells of an experiment that count for a setup: it or the builtin decodes part of the frames."""
        rows = []
        for row, (name, _) in enumerate(self.cells):
            shares = self.shares[BUILTIN.title][row], self.shares[title][row]
            if name == experiment and any(PARTIAL[0] <= share <= PARTIAL[1] for share in shares):
                rows.append(row)
        return np.array(rows, dtype=np.int64)

    def differences(self, rows: NDArray[np.int64], title: str, builtin: str = BUILTIN.title) -> Floats:
        """Share of a setup minus that of a setup of the builtin, in these cells."""
        shares, mine = np.array(self.shares[title]), np.array(self.shares[builtin])
        return np.asarray(shares[rows] - mine[rows])

    def agreeing(self, experiment: str, title: str) -> tuple[int, int]:
        """Cells that agree, and cells that count."""
        rows = self.select(experiment, title)
        return int((np.abs(self.differences(rows, title)) <= WITHIN).sum()), len(rows)

    def closes(self, rows: NDArray[np.int64], swap: Swap) -> NDArray[np.bool_]:
        """Whether both setups of a swap agree, in these cells."""
        return np.asarray(np.abs(self.differences(rows, swap.setup.title, swap.builtin.title)) <= WITHIN)

    def closed(self, experiment: str, swap: Swap) -> tuple[int, int]:
        """Of the cells in which the defaults of an engine disagree, those that a swap closes, and all of them."""
        rows = self.gaps(experiment, swap.setup.engine)
        return int(self.closes(rows, swap).sum()), len(rows)

    def gaps(self, experiment: str, engine: str) -> NDArray[np.int64]:
        """Rows of the cells in which the defaults of an engine disagree with the builtin."""
        title = EngineSetup(engine).title
        rows = self.select(experiment, title)
        return rows[np.abs(self.differences(rows, title)) > WITHIN]

    def explained(self, experiment: str, engine: str, models: float = math.inf) -> tuple[int, int]:
        """Cells that agree with the defaults of an engine or with a swap of at most `models` models, and cells that
        count.
        """
        rows = self.gaps(experiment, engine)
        closed = np.zeros(len(rows), dtype=bool)
        for swap in self.swaps[engine]:
            if len(swap.models) <= models:
                closed |= self.closes(rows, swap)
        agreeing, counting = self.agreeing(experiment, EngineSetup(engine).title)
        return agreeing + int(closed.sum()), counting

    def best(self, row: int, engine: str) -> Swap | None:
        """The swap that explains a cell best: of those that close it, one of the fewest models; else the nearest one.
        None if none was run there.
        """
        swaps = []
        for swap in self.swaps[engine]:
            apart = abs(self.shares[swap.setup.title][row] - self.shares[swap.builtin.title][row])
            if math.isfinite(apart):
                swaps.append((apart > WITHIN, len(swap.models) if apart <= WITHIN else 0, apart, swap))
        return min(swaps, key=lambda each: each[:3])[3] if swaps else None

    def pairs(self, engine: str, *, swapped: bool) -> list[tuple[float, float]]:
        """For each cell the shares of the builtin and of an engine, by their defaults; if `swapped`, those of `best`
        where the defaults disagree.
        """
        shares = list(zip(self.shares[BUILTIN.title], self.shares[EngineSetup(engine).title], strict=True))
        if swapped:
            for experiment in self.experiments:
                for row in self.gaps(experiment, engine).tolist():
                    swap = self.best(row, engine)
                    if swap is not None:
                        shares[row] = self.shares[swap.builtin.title][row], self.shares[swap.setup.title][row]
        return shares


OnStep = Callable[[str, int, int], None]
"""Called with what is being done, steps done, and all steps."""


def compare(city: City, engines: Sequence[str], *, pairs: int = PAIRS, on_step: OnStep | None = None) -> Comparison:
    """Run all experiments with the builtin medium and with `engines`.

    Each engine runs with its defaults and, where these disagree with the builtin, with each of its swaps.
    """
    trials = [*reach_trials(city), *contention_trials(), *hidden_trials()]
    result = Comparison(engines, {engine: SWAPS.get(engine, ()) for engine in engines})
    for trial in trials:
        result.cells += [(trial.experiment, cell.facts) for cell in trial.cells]
    for setup in (BUILTIN, *(EngineSetup(engine) for engine in engines)):
        _run(result, setup, trials, set(range(len(trials))), city, on_step)
    owner = np.repeat(np.arange(len(trials)), [len(trial.cells) for trial in trials])
    for setup, chosen in _swapped(result, owner):
        _run(result, setup, trials, chosen, city, on_step)
    result.losses = draw_pairs(city, pairs)
    models = [model for model in MODELS if model.engine in engines]
    for number, model in enumerate(models):
        if on_step is not None:
            on_step(f"{model.title}: losses of {pairs:,} pairs", number, len(models))
        add_model(result.losses, model, city)
    return result


def _run(
    result: Comparison,
    setup: EngineSetup,
    trials: Sequence[Trial],
    chosen: set[int],
    city: City,
    on_step: OnStep | None,
) -> None:
    """Add the shares of a setup in the cells of the `chosen` trials."""
    shares = result.shares[setup.title] = []
    for number, trial in enumerate(trials):
        if on_step is not None:
            on_step(f"{setup.title}: {trial.experiment}", number, len(trials))
        if number not in chosen:
            shares += [math.nan] * len(trial.cells)
            continue
        decoding = run_trial(trial, setup, city)
        shares += (decoding.decoded / decoding.offered).tolist()
        if setup == BUILTIN:
            result.frames += decoding.offered.tolist()


def _swapped(result: Comparison, owner: NDArray[np.int64]) -> Iterator[tuple[EngineSetup, set[int]]]:
    """Each setup of the swaps that was not run yet, and the trials that have gaps which it may close."""
    setups: dict[str, EngineSetup] = {}
    trials: dict[str, set[int]] = {}
    for engine in result.engines:
        gaps = [result.gaps(experiment, engine) for experiment in result.experiments]
        for swap in result.swaps[engine]:
            for setup in (swap.setup, swap.builtin):
                if setup.title not in result.shares:
                    setups[setup.title] = setup
                    trials.setdefault(setup.title, set()).update(owner[np.concatenate(gaps)].tolist())
    for title, setup in setups.items():
        yield setup, trials[title]
