"""States of a matrix's cells: whether a defence stops an attack, loses missions, or is not shown to do either."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Final, NamedTuple

from skyrange.study.matrix.flights import MatrixResult
from skyrange.study.matrix.model import UNDEFENDED
from skyrange.study.matrix.summary import attack_rows
from skyrange.study.matrix.verdicts import STOPPED


class State(StrEnum):
    """What the flights of one cell show, besides numbers."""

    STOPS = "stops"
    EVERY_FLIGHT = "every"
    NOT_SHOWN = "unshown"
    REMAINS = "remains"
    LOST = "lost"
    IDLE = "idle"
    NO_EFFECT = "none"
    REFUSED = "refused"


class Sign(NamedTuple):
    """How a state is drawn: a sign, so that colour does not tell it alone, its meaning, and its ink."""

    sign: str
    meaning: str
    ink: str


SIGNS: Final = {
    State.STOPS: Sign("✓", "stops the attack", "#0a7a52"),
    State.EVERY_FLIGHT: Sign("(✓)", "stopped it in every flight; too few seeds for a verdict", "#4e9a7a"),
    State.NOT_SHOWN: Sign("n.s.", "less than half of the effect is left, not significant", "#b8860b"),
    State.REMAINS: Sign("!", "half of the effect or more is left", "#c4551c"),
    State.LOST: Sign("✕", "missions are lost that are complete without the attack", "#8f1d4b"),
    State.IDLE: Sign("=", "the defence had nothing to do: as undefended", "#7a8594"),
    State.NO_EFFECT: Sign("0", "no effect without a defence", "#7a8594"),
    State.REFUSED: Sign("–", "cannot be declared here", "#7a8594"),
}


def find_state(result: MatrixResult, row: str, column: str) -> State:
    """The state of a cell of an attack. Lost missions come before a remaining effect."""
    cell, without = result.cell(row, column), result.cell(row)
    if cell.refused:
        return State.REFUSED
    if column in without.idle:
        return State.IDLE
    if not cell.effects or not sum(without.effects):
        return State.NO_EFFECT
    verdict = result.verdicts.of.get((row, column, False))
    if verdict is not None and verdict.stops:
        return State.STOPS
    if not all(cell.complete) or (verdict is not None and verdict.kept < verdict.seeds):
        return State.LOST
    if verdict is not None and verdict.in_every_flight:
        return State.EVERY_FLIGHT
    return State.NOT_SHOWN if sum(cell.effects) < STOPPED * sum(without.effects) else State.REMAINS


def describe_cells(result: MatrixResult) -> str:
    """The matrix in sentences: which defence stops the most attacks, and which attacks none does.

    Where the seeds are too few for a verdict, attacks that were stopped in every flight are counted, and it says so.
    """
    attacks, columns = [row.id for row in attack_rows(result)], [column.id for column in result.matrix.columns]
    states = {(row, column): find_state(result, row, column) for row in attacks for column in columns}
    shown = State.STOPS in states.values()
    counted = State.STOPS if shown else State.EVERY_FLIGHT
    stopped = {column: [row for row in attacks if states[row, column] is counted] for column in columns}
    most = max(map(len, stopped.values()), default=0)
    how = "is shown to stop" if shown else "stopped in every flight"
    if not most:
        return f"No defence {how} any of {len(attacks)} attacks."
    best = [column for column in columns if len(stopped[column]) == most]
    left = [row for row in attacks if not any(row in rows for rows in stopped.values())]
    first = f"{_join(best)} {how if len(best) == 1 or not shown else 'are shown to stop'} the most attacks"
    count = f"{most} of {len(attacks)}{' each' if len(best) > 1 else ''}"
    verdict = "" if shown else ", which is too few for a verdict"
    return f"{first}: {count}{verdict}.{f' None {how} {_join(left)}.' if left else f' Some defence {how} each attack.'}"


def _join(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def count_missions(result: MatrixResult) -> tuple[int, int]:
    """How many missions of the undefended flights without an attack are complete, and of how many."""
    done = [
        complete
        for (_, column), cell in result.cells.items()
        if column == UNDEFENDED
        for run in cell.nominal
        for complete in run.complete
    ]
    return sum(done), len(done)
