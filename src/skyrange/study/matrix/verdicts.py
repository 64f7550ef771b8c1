"""Verdicts of a matrix: which defence is shown to stop which attack, over all of its cells together.

A defence stops an attack if the harm is below half of the undefended one (`share_test`), the missions that are complete
without the attack are complete in more than half of all flights (`sign_test`), and the harm no longer grows. A mission
that the defence itself breaks while nobody attacks is not kept: what stays on the ground cannot be harmed. A cell's p
is the larger of the two, because both have to hold; it is adjusted for the number of cells by Holm's method, so that a
matrix has a false verdict in at most one case in 20.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from skyrange.statistics.means import LEVEL, adjust_by_holm, pairs_needed, share_test, sign_test
from skyrange.study.matrix.cells import Cell
from skyrange.study.matrix.model import UNDEFENDED

STOPPED: Final = 0.5
"""The share of the undefended harm below which an attack is stopped."""
GROWING: Final = 0.1
"""A harm still grows if, at the end of the attack, it grows by more than this share of the undefended one a minute."""

CellKey = tuple[str, str, bool]
"""Row, column, and whether it is of the adversary who knows the defence."""


class Verdict(NamedTuple):
    """What the flights of one cell show of a defence against an attack."""

    seeds: int
    below: int
    """Seeds in which the harm is below half of the undefended one of the same seed."""
    kept: int
    """Seeds in which all missions are complete that are complete without the attack, and the defence breaks none of
    them while nobody attacks."""
    harm_p: float
    """p of the claim that the harm is below half."""
    missions_p: float
    """p of the claim that missions are kept in more than half of all flights."""
    p: float
    """The larger of the two, adjusted for the number of cells."""
    grows: bool

    @property
    def stops(self) -> bool:
        """Whether the defence is shown to stop the attack."""
        return self.p <= LEVEL and not self.grows

    @property
    def in_every_flight(self) -> bool:
        """Whether it stopped the attack in every flight, be they too few for a verdict or not."""
        return self.below == self.kept == self.seeds > 0 and not self.grows


class Verdicts(NamedTuple):
    """The verdicts of a matrix."""

    of: Mapping[CellKey, Verdict]
    """By cell; cells without an effect to stop, and those in which the defence had nothing to do, have none."""

    @property
    def seeds_needed(self) -> int:
        """The fewest seeds with which a verdict of as many tests is possible; of an adversary, who chooses by half of
        the seeds, it takes twice as many.
        """
        return pairs_needed(len(self.of))

    def stops(self, row: str, column: str, *, adaptive: bool = False) -> bool:
        """Whether a defence is shown to stop an attack."""
        verdict = self.of.get((row, column, adaptive))
        return verdict is not None and verdict.stops

    def in_every_flight(self, row: str, column: str, *, adaptive: bool = False) -> bool:
        """Whether a defence stopped an attack in every flight."""
        verdict = self.of.get((row, column, adaptive))
        return verdict is not None and verdict.in_every_flight


def judge_cells(cells: Mapping[tuple[str, str], Cell]) -> Verdicts:
    """The verdicts of the cells of a matrix, by row and column."""
    compared: dict[CellKey, tuple[Cell, Cell]] = {}
    for (row, column), cell in cells.items():
        without = cells.get((row, UNDEFENDED))
        if column == UNDEFENDED or without is None or cell.fault or not cell.effects or not sum(without.effects):
            continue
        if column not in without.idle:
            compared[row, column, False] = cell, without
        if (best := cell.best_adaptive) is not None:
            compared[row, column, True] = best, without.since(len(without.effects) - len(best.effects))
    harm = [share_test(cell.effects, without.effects, STOPPED) for cell, without in compared.values()]
    kept = [
        missions_kept(cell.complete, cells[row, column], cells[row, UNDEFENDED])
        for (row, column, _), (cell, _) in compared.items()
    ]
    missions = [sign_test(sum(seeds), len(seeds)) for seeds in kept]
    adjusted = adjust_by_holm(list(map(max, harm, missions)))
    return Verdicts(
        {
            key: Verdict(
                len(cell.effects),
                sum(a < STOPPED * b for a, b in zip(cell.effects, without.effects, strict=True)),
                sum(seeds),
                harm_p,
                missions_p,
                p,
                still_grows(cell, without),
            )
            for (key, (cell, without)), seeds, harm_p, missions_p, p in zip(
                compared.items(), kept, harm, missions, adjusted, strict=True
            )
        }
    )


def missions_kept(complete: Sequence[bool], cell: Cell, without: Cell) -> list[bool]:
    """Of each of the last seeds, whether missions are complete as without the attack, by `complete`, and the defence
    breaks none of them in its nominal run, which those of candidates share.
    """
    count = len(complete)
    if len(cell.nominal) < count or len(without.nominal) < count:
        return list(complete)
    return [
        seed
        and all(done or not done_without for done, done_without in zip(run.complete, run_without.complete, strict=True))
        for seed, run, run_without in zip(
            complete, cell.nominal[len(cell.nominal) - count :], without.nominal[len(without.nominal) - count :],
            strict=True,
        )
    ]  # fmt: skip


def still_grows(cell: Cell, without: Cell) -> bool:
    """Whether the harm of a cell grew on at the end of the attack: it would be larger had the attack gone on."""
    speed = measured_growth(cell)
    if speed is None or not without.effects:
        return False
    return speed > GROWING * math.fsum(without.effects) / len(without.effects)


def measured_growth(cell: Cell) -> float | None:
    """The mean growth at the end of the attack, in metres a minute; `None` where none was measured."""
    speeds = [speed for speed in cell.growth_m_per_min if speed is not None]
    return math.fsum(speeds) / len(speeds) if speeds else None
