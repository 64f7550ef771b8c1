"""Sections of a matrix's page as data, and their text in Markdown: effects, alarms, costs, candidates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from skyrange.statistics.exact_intervals import Limits
from skyrange.statistics.means import Interval
from skyrange.study.matrix.cells import Cell
from skyrange.study.matrix.flights import MatrixResult
from skyrange.study.matrix.model import UNDEFENDED, Row
from skyrange.study.matrix.summary import (
    UNITS,
    Count,
    FaultHarm,
    attack_rows,
    cost_of,
    describe_cell,
    fault_rows,
    format_effect,
    refusals,
)

INTRODUCTION = """\
Each cell is a [pair](pair-folder.md): the row's scenario with its attack and without, {seeds} seeds, with the column's
defence in both. A number is the mean effect on the aircraft that is affected most, in the unit of the row, with its
95 % interval; a mean without one has none, because all or most of its flights agree. "2 of 5 complete": missions are
complete in 2 of 5 runs, of those that are without the attack. "grows by 3.0/min": so fast the effect still grew in the
second half of the attack, or in its last minute: it would be larger had the attack gone on.

**Bold**: the defence is shown to stop the attack. Its effect is below half of the undefended one, missions are kept,
and it does not grow by more than a tenth of the undefended one a minute. The tests are adjusted for the {tests} cells
that are tested, so that a matrix has any false verdict with a probability of at most 5 %. A verdict takes {needed}
seeds. *Italic*: it is so in every flight of the cell, but these are too few to show it.

The second number is that of an adversary who knows the defence. It does what it did before, or one of its candidates,
whichever has the largest effect with the first half of the seeds; the number is that of the other half. With one seed
both are that one. A verdict of an adversary takes twice as many seeds. *non-adaptive*:
no adversary of the matrix knows this defence. "–": the defence cannot be declared in this scenario; the reasons are
below.
"""
VERDICTS = """\
`harm`: seeds in which the effect is below half of the undefended one. `missions`: seeds in which every mission is
complete that is complete without the attack, and that the defence does not break while nobody attacks. Each with the p
of the claim that this holds for most flights; `p` is the larger of the two, adjusted for the number of cells. Cells
whose effect is below half in no seed are left out.
"""
COST = """\
False alarms, broken missions, delay and energy are those of flights without an attack, against the same flights
without the defence. `stops`: attacks that it is shown to stop, and those that it stops in every flight, of those in
whose scenarios it can be declared. `without assumptions`: the same without attacks on sensors whose reaction is
assumed. `adaptive`: attacks that it stops although the adversary knows it. `false alarms`: alerts about an aircraft
within 30 s are one; flights of several rows that are the same count once; the limits are 95 % if alarms are
independent. `broken missions`: missions that are complete without the defence alone; they have no delay. Delay and
energy are means over rows, then over seeds, without rows that lack a value for some seed. `with benign faults`: each
fault with an alarm, or with an effect that is larger with the defence by a tenth and by its limits; the mean effect
without the defence and with it, and the alarms an aircraft-hour of flight with the fault, all false. `honest`: runs
with an alarm, of those in which a real aircraft flies where the attack would claim one. `latency of frames`: growth of
the median and of the 95th percentile of the time from sender to the end of processing, on the links that the defence
protects. Processor time counts only where the column declares a `cost`.
"""
FAULTS = """\
Effect of the fault with each defence, and alarms in the runs with the fault, which are all false.
"""


IDLE = """\
In the undefended flights of these rows the defences were present and muted, and would have done nothing in any of them:
no alarm, no verdict, no altered reading. Had they acted, every flight would be the same to the byte, so these cells are
the undefended one and link to it.
"""
ASSUMED = """\
The table of effects once more, without attacks on sensors whose reaction is assumed and not simulated or cited, by what
their kinds say of their realism. Left out: {left_out}.
"""


EFFECT: Final = "Effect"
"""The title of the first section."""


class Shown(NamedTuple):
    """One cell of a table: a text, and another one after it."""

    text: str
    name: bool = False
    """Whether the text is a name of the matrix or of a parameter."""
    strong: bool = False
    slanted: bool = False
    folder: str = ""
    """Folder of the pair that it is from, relative to the matrix; "" for none."""
    after: str = ""
    after_strong: bool = False
    after_slanted: bool = False


class Section(NamedTuple):
    """A heading, what to know, and a table."""

    title: str
    text: str
    head: Sequence[str]
    rows: Sequence[Sequence[Shown]]


def make_sections(result: MatrixResult) -> list[Section]:
    """The sections of a matrix's page, without those that have no rows."""
    ids = [column.id for column in result.matrix.columns]
    attacks, faults = attack_rows(result), fault_rows(result)
    assumed = [row.id for row in attacks if result.cell(row.id).assumed]
    kept = [row for row in attacks if row.id not in assumed] if assumed else []
    sections = [
        Section(EFFECT, "", ["attack", UNDEFENDED, *ids], [_effects(result, row) for row in attacks]),
        Section(
            "Effect without assumed reactions of sensors",
            ASSUMED.format(left_out=", ".join(f"`{name}`" for name in assumed)),
            ["attack", UNDEFENDED, *ids],
            [_effects(result, row) for row in kept],
        ),
        Section("Verdicts", VERDICTS, _VERDICT_HEAD, list(_verdicts(result))),
        Section(
            "Time to alarm",
            "From the attack's start: the mean, in which a seed without an alarm counts with the time to the end of "
            "its run; and seeds with an alarm.",
            ["attack", *ids],
            [
                [Shown(row.id, name=True), *(Shown(describe_cell(result, row, column).alarm) for column in ids)]
                for row in attacks
            ],
        ),
        Section("Cost and worth of each defence", COST, _COST_HEAD, list(_costs(result))),
        Section("With benign faults", FAULTS, ["fault", UNDEFENDED, *ids], [_faults(result, row) for row in faults]),
        Section(
            "Adversaries who know the defence",
            "Candidates, and the effect of each.",
            ["attack", "defence", "candidate", "effect"],
            list(_candidates(result)),
        ),
        Section(
            "Defences with nothing to do",
            IDLE,
            ["attack or fault", "defences"],
            [
                [Shown(row.id, name=True), Shown(", ".join(result.cell(row.id).idle))]
                for row in result.matrix.rows
                if result.cell(row.id).idle
            ],
        ),
        Section("Cells that are not flown", "", ["defence", "why"], list(_reasons(result))),
    ]
    return [section for section in sections if section.rows]


def describe_quick_look(result: MatrixResult) -> str:
    """One line that says that the seeds are too few for any verdict; "" if they are not."""
    seeds, needed = result.matrix.seeds, result.verdicts.seeds_needed
    if seeds >= needed:
        return ""
    count = f"{seeds} seed{'s' * (seeds > 1)}"
    return f"A quick look with {count} carries no claim: a verdict takes {needed} seeds, of an adversary {2 * needed}."


def introduce(result: MatrixResult) -> str:
    """What the numbers of a matrix mean, in Markdown."""
    verdicts = result.verdicts
    return INTRODUCTION.format(seeds=result.matrix.seeds, tests=len(verdicts.of), needed=verdicts.seeds_needed)


def write_markdown(result: MatrixResult, title: str, figure: str, *, links: bool) -> str:
    """The page in Markdown; with `links`, cells lead to their reports. `figure` names the image, "" for none."""
    parts = [f"# {title}\n"] if title else []
    if failed := result.failed_missions:
        parts.append("**Missions failed without an attack:**\n")
        parts.append("".join(f"- {line}\n" for line in failed))
    if quick_look := describe_quick_look(result):
        parts.append(f"**{quick_look}**\n")
    parts.append(introduce(result))
    if figure:
        parts.append(f"![Effect with each defence, as a share of the undefended effect]({figure})\n")
    for section in make_sections(result):
        parts.append(f"## {section.title}\n")
        if section.text:
            parts.append(f"{section.text.strip()}\n")
        rows = [[_markdown(cell, links=links) for cell in row] for row in section.rows]
        lines = [list(section.head), ["---"] * len(section.head), *rows]
        parts.append("".join(f"| {' | '.join(line)} |\n" for line in lines))
    return "\n".join(parts)


def _markdown(cell: Shown, *, links: bool) -> str:
    text = cell.text.replace("|", "\\|").replace("\n", " ")
    if cell.name:
        return f"`{text}`"
    text = f"[{text}]({cell.folder}/report.html)" if links and cell.folder else text
    text = _mark(text, strong=cell.strong, slanted=cell.slanted)
    if not cell.after:
        return text
    return f"{text}; {_mark(cell.after, strong=cell.after_strong, slanted=cell.after_slanted)}"


def _mark(text: str, *, strong: bool, slanted: bool) -> str:
    return f"**{text}**" if strong else f"*{text}*" if slanted else text


def _effects(result: MatrixResult, row: Row) -> list[Shown]:
    line = [Shown(f"{row.id} ({UNITS[row.measure][0]})", name=True)]
    for column in (UNDEFENDED, *(defence.id for defence in result.matrix.columns)):
        text = describe_cell(result, row, column)
        after = "" if column == UNDEFENDED or text.refused else text.adaptive
        line.append(
            Shown(
                text.effect,
                strong=text.stops,
                slanted=text.in_every_flight,
                folder=text.folder,
                after=after,
                after_strong=text.stops_adaptive,
                after_slanted=text.in_every_flight_adaptive,
            )
        )
    return line


_VERDICT_HEAD: Final = ("attack", "defence", "adversary", "harm", "missions", "p", "verdict")


def _verdicts(result: MatrixResult) -> Iterator[list[Shown]]:
    for (row, column, adaptive), verdict in result.verdicts.of.items():
        if not verdict.below:
            continue
        word = "stops" if verdict.stops else "not shown: grows" if verdict.grows else "not shown"
        if verdict.in_every_flight and not verdict.stops:
            needed = result.verdicts.seeds_needed * (2 if adaptive else 1)
            word = f"in every flight; a verdict takes {needed} seeds"
        texts = (
            "knows the defence" if adaptive else "",
            f"{verdict.below} of {verdict.seeds}, p = {verdict.harm_p:.2g}",
            f"{verdict.kept} of {verdict.seeds}, p = {verdict.missions_p:.2g}",
            f"{verdict.p:.2g}",
            word,
        )
        yield [Shown(row, name=True), Shown(column, name=True), *map(Shown, texts)]


_COST_HEAD: Final = (
    "defence", "stops", "without assumptions", "adaptive", "false alarms an aircraft-hour", "with benign faults",
    "honest", "broken missions", "delay, s", "energy, J", "frames an aircraft-hour", "latency of frames, ms",
)  # fmt: skip


def _costs(result: MatrixResult) -> Iterator[list[Shown]]:
    for column in result.matrix.columns:
        cost = cost_of(result, column)
        texts = (
            _count(cost.all),
            _count(cost.simulated),
            _count(cost.adaptive) if cost.adaptive.of else "non-adaptive",
            format_alarms(cost.false_alarms, cost.flown_h, cost.false_per_h),
            _harms(cost.faults),
            f"{cost.honest_alarms} of {cost.of_honest}" if cost.of_honest else "–",
            f"{cost.broken} of {cost.missions}",
            _difference(cost.delay),
            _difference(cost.energy),
            f"{cost.frames_per_h:+.0f}" if cost.flown_h else "–",
            "–" if cost.latency_ms is None else f"{cost.latency_ms[0]:+.2f}, {cost.latency_ms[1]:+.2f}",
        )
        yield [Shown(column.id, name=True), *map(Shown, texts)]


def _harms(faults: Sequence[FaultHarm]) -> str:
    """The faults with which a defence does harm; "none" if it was flown with faults and does none."""
    texts = []
    for harm in faults:
        if harm.is_harm:
            unit, factor = UNITS[harm.measure]
            change = f"{factor * harm.without:.1f} → {factor * harm.defended:.1f} {unit}"
            texts.append(f"{harm.row}: {change}, {harm.alarms_per_h:.0f} alarms/h")
    return "; ".join(texts) or ("none" if faults else "–")


def _count(count: Count) -> str:
    return f"{count.shown} of {count.of}, {count.in_every_flight} in every flight"


def format_alarms(alarms: int, hours: float, limits: Limits) -> str:
    """A rate of false alarms with what it is from; without an alarm the upper limit alone says something."""
    counted = f"{alarms} in {hours:.2f} h"
    if not hours:
        return "no flight"
    if not alarms:
        return f"{counted}: at most {limits[1]:.1f}"
    return f"{counted}: {alarms / hours:.1f} [{limits[0]:.1f}, {limits[1]:.1f}]"


def _difference(value: Interval | None) -> str:
    if value is None:
        return "–"
    text = f"{value.mean:+.2f}"
    if value.low is None or value.high is None:
        return f"{text} ({value.without})" if value.mean else text
    return f"{text} [{value.low:+.2f}, {value.high:+.2f}]"


def _faults(result: MatrixResult, row: Row) -> list[Shown]:
    line = [Shown(f"{row.id} ({UNITS[row.measure][0]})", name=True)]
    for column in (UNDEFENDED, *(defence.id for defence in result.matrix.columns)):
        cell = result.cell(row.id, column)
        after = "" if column == UNDEFENDED or cell.refused else _alarm_rate(cell)
        line.append(Shown(format_effect(cell.effect, row.measure, unit=False), folder=cell.folder, after=after))
    return line


def _alarm_rate(cell: Cell) -> str:
    """Alarms of a defence in runs with a fault: a count, because flights of one row are few and alike."""
    count, minutes = sum(cell.fault_alarms), 60.0 * sum(cell.flown_h)
    return f"{count} in {minutes:.0f} min" if minutes else ""


def _candidates(result: MatrixResult) -> Iterator[list[Shown]]:
    for row in attack_rows(result):
        for column in result.matrix.columns:
            for candidate in result.cell(row.id, column.id).adaptive:
                effect = Shown(format_effect(candidate.effect, row.measure), folder=candidate.folder)
                yield [Shown(row.id, name=True), Shown(column.id, name=True), Shown(candidate.candidate), effect]


def _reasons(result: MatrixResult) -> Iterator[list[Shown]]:
    for column, reason in dict.fromkeys((column, reason) for _, column, reason in refusals(result)):
        yield [Shown(column, name=True), Shown(reason)]
