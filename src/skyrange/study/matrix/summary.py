"""Summary of a matrix: texts of its cells, which defence stops which attack, and what each defence costs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from skyrange.study.matrix.cells import Cell, added_delay_s, added_energy_j, added_frames, added_transit_ms
from skyrange.study.matrix.flights import MatrixResult
from skyrange.study.matrix.model import UNDEFENDED, Column, Row
from skyrange.study.twins.confidence import Interval, interval

UNITS: Final = {
    "departure_m": ("m", 1.0), "strayed_m": ("m", 1.0), "extra_distance_m": ("m", 1.0),
    "extra_energy_j": ("kJ", 1e-3), "mission": ("missions", 1.0), "mishaps": ("mishaps", 1.0),
    "telemetry": ("%", 1.0),
}  # fmt: skip
"""By measure: unit and factor."""
STOPPED: Final = 0.5
"""A defence stops an attack if the mean effect is at most this share of the undefended one, and the difference of the
two is not zero at 95 %."""


@dataclass(frozen=True, slots=True)
class CellText:
    """A cell as it is shown."""

    effect: str
    adaptive: str
    """The effect of the adversary who knows the defence; "non-adaptive" where there is none."""
    alarm: str
    stops: bool
    stops_adaptive: bool | None
    """`None` where no adversary knows the defence."""
    share: float | None
    """Mean effect as a share of the undefended one; `None` where that is zero or the cell was not flown."""
    folder: str
    refused: str


@dataclass(frozen=True, slots=True)
class Cost:
    """What one defence costs in flights without an attack, and how many attacks it stops."""

    column: str
    stopped: int
    of: int
    stopped_simulated: int
    """The same without attacks whose effect rests on assumed sensor behaviour."""
    of_simulated: int
    stopped_adaptive: int
    of_adaptive: int
    false_alarms: int
    flown_h: float
    delay: Interval | None
    """Of missions, in seconds."""
    energy: Interval | None
    """In joules."""
    frames_per_h: float
    honest_alarms: int
    of_honest: int
    latency_ms: tuple[float, float] | None = None
    """Mean growth of median and 95th percentile of the delay of frames on the links that it protects."""


def format_effect(effect: Interval | None, measure: str, unit: bool = True) -> str:
    """A mean effect with its interval and unit."""
    if effect is None:
        return "–"
    name, factor = UNITS[measure]
    text = f"{factor * effect.mean:.1f}"
    if effect.low is not None and effect.high is not None:
        text += f" [{factor * effect.low:.1f}, {factor * effect.high:.1f}]"
    return f"{text} {name}" if unit else text


def stops(cell: Cell, without: Cell) -> bool:
    """Whether a defence stops an attack, by `STOPPED` and a paired comparison over the seeds."""
    if not cell.effects or len(cell.effects) != len(without.effects) or not sum(without.effects):
        return False
    less = interval([b - a for a, b in zip(cell.effects, without.effects, strict=True)])
    return (
        less is not None
        and less.low is not None  # one seed proves nothing
        and less.low > 0.0
        and sum(cell.effects) <= STOPPED * sum(without.effects)
    )


def _format(cell: Cell, measure: str) -> str:
    """The effect of a cell, and in how many runs missions are complete, if that is not all of them."""
    text, done = format_effect(cell.effect, measure, False), sum(cell.complete)
    return text if done == len(cell.complete) else f"{text}, {done} of {len(cell.complete)} complete"


def describe_cell(result: MatrixResult, row: Row, column: str) -> CellText:
    """One cell as it is shown."""
    cell, without = result.cell(row.id, column), result.cell(row.id)
    best = cell.best_adaptive
    told = sum(at is not None for at in cell.alarms_s)
    alarm = "none" if cell.alarm_s is None else f"{cell.alarm_s:.1f} s, {told} of {len(cell.alarms_s)}"
    if cell.refused or column == UNDEFENDED:
        alarm = "–"
    undefended = sum(without.effects)
    return CellText(
        _format(cell, row.measure),
        _format(best, row.measure) if best is not None else "non-adaptive",
        alarm,
        stops(cell, without),
        None if best is None else stops(best, without),
        sum(cell.effects) / undefended if cell.effects and undefended else None,
        cell.folder,
        cell.refused,
    )


def cost_of(result: MatrixResult, column: Column) -> Cost:
    """What a defence costs, over all cells of its column that were flown."""
    rows = [row for row in result.matrix.rows if not result.cell(row.id, column.id).refused]
    attacks = [row for row in rows if not result.cell(row.id).fault]
    simulated = [row for row in attacks if not result.cell(row.id).assumed]
    stopped = {row.id for row in attacks if stops(result.cell(row.id, column.id), result.cell(row.id))}
    adaptive = [row for row in attacks if result.cell(row.id, column.id).best_adaptive is not None]
    cells = [(result.cell(row.id, column.id), result.cell(row.id)) for row in rows]
    honest = [one for cell, _ in cells for one in cell.honest_alarms]
    hours = sum(sum(cell.flown_h) for cell, _ in cells)
    return Cost(
        column.id,
        len(stopped),
        len(attacks),
        sum(row.id in stopped for row in simulated),
        len(simulated),
        sum(_stops_adaptive(result, row, column) for row in adaptive),
        len(adaptive),
        sum(sum(cell.false_alarms) for cell, _ in cells),
        hours,
        interval([one for cell, without in cells for one in added_delay_s(cell, without)]),
        interval([one for cell, without in cells for one in added_energy_j(cell, without)]),
        sum(sum(added_frames(cell, without)) for cell, without in cells) / hours if hours else 0.0,
        sum(honest),
        len(honest),
        _mean_latency([one for cell, without in cells for one in added_transit_ms(cell, without, _roles(column))]),
    )


def _roles(column: Column) -> list[str]:
    """What the kinds of a column protect: roles of links, and others that no link has."""
    return list(dict.fromkeys(role for table in column.tables() for role in table.plugin.surface))


def _mean_latency(found: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """The means over cells and seeds; `None` where there is none."""
    if not found:
        return None
    return sum(one for one, _ in found) / len(found), sum(two for _, two in found) / len(found)


def _stops_adaptive(result: MatrixResult, row: Row, column: Column) -> bool:
    best = result.cell(row.id, column.id).best_adaptive
    return best is not None and stops(best, result.cell(row.id))


def attack_rows(result: MatrixResult) -> Sequence[Row]:
    """Rows with an attack."""
    return [row for row in result.matrix.rows if not result.cell(row.id).fault]


def fault_rows(result: MatrixResult) -> Sequence[Row]:
    """Rows with benign faults alone."""
    return [row for row in result.matrix.rows if result.cell(row.id).fault]


def refusals(result: MatrixResult) -> Iterator[tuple[str, str, str]]:
    """Row, column and reason of each cell that was not flown."""
    for (row, column), cell in result.cells.items():
        if cell.refused:
            yield row, column, cell.refused
