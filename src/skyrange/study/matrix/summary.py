"""Summary of a matrix: texts of its cells, which defence stops which attack, and what each defence costs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from skyrange.statistics.exact_intervals import Limits, rate_interval
from skyrange.statistics.means import CONFIDENCE, Interval, estimate_mean
from skyrange.study.matrix.cells import (
    Cell,
    added_delay_s,
    added_energy_j,
    added_frames,
    added_transit_ms,
    broken_missions,
)
from skyrange.study.matrix.flights import MatrixResult
from skyrange.study.matrix.model import UNDEFENDED, Column, Row
from skyrange.study.matrix.verdicts import measured_growth

UNITS: Final = {
    "departure_m": ("m", 1.0), "strayed_m": ("m", 1.0), "extra_distance_m": ("m", 1.0),
    "extra_energy_j": ("kJ", 1e-3), "mission": ("missions", 1.0), "mishaps": ("mishaps", 1.0),
    "telemetry": ("%", 1.0),
}  # fmt: skip
"""By measure: unit and factor."""


@dataclass(frozen=True, slots=True)
class CellText:
    """A cell as it is shown."""

    effect: str
    adaptive: str
    """The effect of the adversary who knows the defence; "non-adaptive" where there is none."""
    alarm: str
    stops: bool
    in_every_flight: bool
    """Whether the attack was stopped in every flight, be they too few for a verdict or not."""
    stops_adaptive: bool
    in_every_flight_adaptive: bool
    share: float | None
    """Mean effect as a share of the undefended one; `None` where that is zero or the cell was not flown."""
    folder: str
    refused: str


LEAST_HARM: Final = 0.1
"""Share by which the effect of a fault has to grow with a defence to be called harm."""
LEAST_GROWTH: Final = 0.1
"""Growth that is shown, in metres a minute."""


class Count(NamedTuple):
    """Attacks that a defence stops."""

    shown: int
    """By the verdicts of the matrix."""
    in_every_flight: int
    """In every flight, be they too few for a verdict or not."""
    of: int


class FaultHarm(NamedTuple):
    """What a defence does with one benign fault."""

    row: str
    measure: str
    without: float
    """Mean effect of the fault without the defence, in the unit of the measure."""
    defended: float
    """The same with it."""
    least: float
    """The lower 95 % limit of that; the mean where it has none."""
    alarms_per_h: float
    """Alarms an aircraft-hour of the runs with the fault, all of them false."""

    @property
    def is_harm(self) -> bool:
        """Whether there are alarms, or the effect is larger with the defence, by a tenth and by its limits."""
        larger = self.defended > (1.0 + LEAST_HARM) * self.without and self.least > self.without
        return self.alarms_per_h > 0.0 or larger


@dataclass(frozen=True, slots=True)
class Cost:
    """What one defence costs in flights without an attack, and how many attacks it stops."""

    column: str
    all: Count
    simulated: Count
    """Without attacks whose effect rests on assumed sensor behaviour."""
    adaptive: Count
    """Of attacks whose adversary knows the defence."""
    false_alarms: int
    flown_h: float
    """Aircraft-hours of nominal flights; those that are the same flight count once."""
    false_per_h: Limits
    """The 95 % limits of the rate of false alarms, if they do not depend on each other."""
    broken: int
    """Missions of nominal flights that the defence breaks."""
    missions: int
    """Missions that are complete without it."""
    delay: Interval | None
    """Of missions that are complete with it and without it, in seconds."""
    energy: Interval | None
    """In joules."""
    frames_per_h: float
    honest_alarms: int
    of_honest: int
    faults: tuple[FaultHarm, ...]
    """Of each row with a benign fault in whose scenario it can be declared."""
    latency_ms: tuple[float, float] | None = None
    """Mean growth of median and 95th percentile of the delay of frames on the links that it protects."""


def format_effect(effect: Interval | None, measure: str, *, unit: bool = True) -> str:
    """A mean effect with its interval and unit."""
    if effect is None:
        return "–"
    name, factor = UNITS[measure]
    text = f"{factor * effect.mean:.1f}"
    if effect.low is not None and effect.high is not None:
        text += f" [{factor * effect.low:.1f}, {factor * effect.high:.1f}]"
    return f"{text} {name}" if unit else text


def _format(cell: Cell, measure: str) -> str:
    """The effect of a cell; in how many runs missions are complete, if not in all; how it still grows, if it does."""
    text, done = format_effect(cell.effect, measure, unit=False), sum(cell.complete)
    if done < len(cell.complete):
        text += f", {done} of {len(cell.complete)} complete"
    speed = measured_growth(cell)
    return f"{text}, grows by {speed:.1f}/min" if speed is not None and speed >= LEAST_GROWTH else text


def describe_cell(result: MatrixResult, row: Row, column: str) -> CellText:
    """One cell as it is shown."""
    cell, without, verdicts = result.cell(row.id, column), result.cell(row.id), result.verdicts
    best = cell.best_adaptive
    alarmed = sum(at is not None for at in cell.alarms_s)
    alarm = f"{cell.alarm_s:.1f} s, {alarmed} of {len(cell.alarms_s)}" if alarmed else "none"
    if cell.alarm_s is None or cell.refused or column == UNDEFENDED:
        alarm = "–"
    undefended = sum(without.effects)
    return CellText(
        _format(cell, row.measure),
        "non-adaptive" if best is None else _format(best, row.measure),
        alarm,
        verdicts.stops(row.id, column),
        verdicts.in_every_flight(row.id, column),
        verdicts.stops(row.id, column, adaptive=True),
        verdicts.in_every_flight(row.id, column, adaptive=True),
        sum(cell.effects) / undefended if cell.effects and undefended else None,
        cell.folder,
        cell.refused,
    )


def cost_of(result: MatrixResult, column: Column) -> Cost:
    """What a defence costs, over all cells of its column that were flown."""
    rows = [row for row in result.matrix.rows if not result.cell(row.id, column.id).refused]
    attacks = [row for row in rows if not result.cell(row.id).fault]
    simulated = [row for row in attacks if not result.cell(row.id).assumed]
    adaptive = [row for row in attacks if result.cell(row.id, column.id).best_adaptive is not None]
    cells = [(result.cell(row.id, column.id), result.cell(row.id)) for row in rows]
    honest = [alarm for cell, _ in cells for alarm in cell.honest_alarms]
    flights = {
        run.flight or f"{cell.row} {number}": (count, hours)
        for cell, _ in cells
        for number, (run, count, hours) in enumerate(zip(cell.nominal, cell.false_alarms, cell.flown_h, strict=True))
    }
    alarms, flown_h = sum(count for count, _ in flights.values()), sum(hours for _, hours in flights.values())
    hours = sum(sum(cell.flown_h) for cell, _ in cells)
    broken = [broken_missions(cell, without) for cell, without in cells]
    return Cost(
        column.id,
        _count(result, attacks, column),
        _count(result, simulated, column),
        _count(result, adaptive, column, adaptive=True),
        alarms,
        flown_h,
        rate_interval(alarms, flown_h, CONFIDENCE),
        sum(count for count, _ in broken),
        sum(of for _, of in broken),
        mean_over_rows([added_delay_s(cell, without) for cell, without in cells]),
        mean_over_rows([added_energy_j(cell, without) for cell, without in cells]),
        sum(sum(added_frames(cell, without)) for cell, without in cells) / hours if hours else 0.0,
        sum(honest),
        len(honest),
        tuple(_fault_harms(result, column)),
        _mean_latency(
            [growth for cell, without in cells for growth in added_transit_ms(cell, without, _roles(column))]
        ),
    )


def _fault_harms(result: MatrixResult, column: Column) -> Iterator[FaultHarm]:
    for row in fault_rows(result):
        cell, without = result.cell(row.id, column.id), result.cell(row.id)
        if cell.refused or not cell.effects or not without.effects:
            continue
        hours, effect = sum(cell.flown_h), cell.effect
        usual, mean = (sum(compared.effects) / len(compared.effects) for compared in (without, cell))
        least = mean if effect is None or effect.low is None else effect.low
        yield FaultHarm(row.id, row.measure, usual, mean, least, sum(cell.fault_alarms) / hours if hours else 0.0)


def _count(result: MatrixResult, rows: Sequence[Row], column: Column, *, adaptive: bool = False) -> Count:
    verdicts = result.verdicts
    return Count(
        sum(verdicts.stops(row.id, column.id, adaptive=adaptive) for row in rows),
        sum(verdicts.in_every_flight(row.id, column.id, adaptive=adaptive) for row in rows),
        len(rows),
    )


def mean_over_rows(rows: Sequence[Sequence[float]]) -> Interval | None:
    """The mean over rows for each seed, and then over seeds: the rows are given, the seeds are a sample. Rows that lack
    a value for some seed are left out, because the mean of other rows is not the same quantity.
    """
    complete = [row for row in rows if not any(math.isnan(value) for value in row)]
    return estimate_mean([math.fsum(values) / len(values) for values in zip(*complete, strict=True)])


def _roles(column: Column) -> list[str]:
    """What the kinds of a column protect: roles of links, and others that no link has."""
    return list(dict.fromkeys(role for table in column.tables() for role in table.plugin.surface))


def _mean_latency(growths: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """The means over cells and seeds; `None` where there is none."""
    if not growths:
        return None
    return sum(median for median, _ in growths) / len(growths), sum(tail for _, tail in growths) / len(growths)


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
