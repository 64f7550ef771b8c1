"""Sections of a matrix's page as data, and their text in Markdown: effects, alarms, costs, candidates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from skyrange.study.matrix.cells import Cell
from skyrange.study.matrix.flights import MatrixResult
from skyrange.study.matrix.model import UNDEFENDED, Row
from skyrange.study.matrix.summary import (
    UNITS,
    attack_rows,
    cost_of,
    describe_cell,
    fault_rows,
    format_effect,
    refusals,
)
from skyrange.study.twins.confidence import Interval

INTRODUCTION = """\
Each cell is a [pair](pair-folder.md): the row's scenario with its attack and without, {seeds} seeds, with the column's
defence in both. A number is the mean effect on the aircraft that is affected most, with its 95 % interval, in the unit
of the row. **Bold**: the defence stops the attack, which means that the effect is at most half of the undefended one
and that the difference over the seeds is not zero at 95 %, which takes two seeds. "2 of 5 complete": missions are
complete in 2 of 5 runs, of those that are without the attack. The second number is that of an adversary who knows the
defence and does what is best for it: what it did before, or one of its candidates. *non-adaptive*: no adversary of the
matrix knows this defence. "–": the defence cannot be declared in this scenario; the reasons are below.
"""
COST = """\
False alarms, delay and energy are those of flights without an attack, against the same flights without the defence.
`stops`: attacks that it stops, of those in whose scenarios it can be declared. `without assumptions`: the same without
attacks on sensors whose reaction is assumed. `adaptive`: attacks that it stops although the adversary knows it.
`honest`: runs with an alarm, of those in which a real aircraft flies where the attack would claim one. `latency of
frames`: growth of the median and of the 95th percentile of the time from sender to the end of processing, on the links
that the defence protects. Processor time counts only where the column declares a `cost`.
"""
FAULTS = """\
Effect of the fault with each defence, and alarms an aircraft-hour of the run with the fault: all of them are false.
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


class Shown(NamedTuple):
    """One cell of a table: a text, and another one after it."""

    text: str
    name: bool = False
    """Whether the text is a name of the matrix or of a parameter."""
    strong: bool = False
    folder: str = ""
    """Folder of the pair that it is from, relative to the matrix; "" for none."""
    after: str = ""
    after_strong: bool = False


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
    found = [
        Section("Effect", "", ["attack", UNDEFENDED, *ids], [_effects(result, row) for row in attacks]),
        Section(
            "Effect without assumed reactions of sensors",
            ASSUMED.format(left_out=", ".join(f"`{one}`" for one in assumed)),
            ["attack", UNDEFENDED, *ids],
            [_effects(result, row) for row in kept],
        ),
        Section(
            "Time to alarm",
            "From the attack's start; mean, and seeds with an alarm.",
            ["attack", *ids],
            [[Shown(row.id, True), *(Shown(describe_cell(result, row, one).alarm) for one in ids)] for row in attacks],
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
                [Shown(row.id, True), Shown(", ".join(result.cell(row.id).idle))]
                for row in result.matrix.rows
                if result.cell(row.id).idle
            ],
        ),
        Section("Cells that are not flown", "", ["defence", "why"], list(_reasons(result))),
    ]
    return [section for section in found if section.rows]


def write_markdown(result: MatrixResult, title: str, figure: str, links: bool) -> str:
    """The page in Markdown; with `links`, cells lead to their reports. `figure` names the image, "" for none."""
    parts = [f"# {title}\n"] if title else []
    if failed := result.failed_missions:
        parts.append("**Missions failed without an attack:**\n")
        parts.append("".join(f"- {line}\n" for line in failed))
    parts.append(INTRODUCTION.format(seeds=result.matrix.seeds))
    if figure:
        parts.append(f"![Effect with each defence, as a share of the undefended effect]({figure})\n")
    for section in make_sections(result):
        parts.append(f"## {section.title}\n")
        if section.text:
            parts.append(f"{section.text.strip()}\n")
        rows = [[_markdown(cell, links) for cell in row] for row in section.rows]
        lines = [list(section.head), ["---"] * len(section.head), *rows]
        parts.append("".join(f"| {' | '.join(line)} |\n" for line in lines))
    return "\n".join(parts)


def _markdown(cell: Shown, links: bool) -> str:
    text = cell.text.replace("|", "\\|").replace("\n", " ")
    if cell.name:
        return f"`{text}`"
    text = f"[{text}]({cell.folder}/report.html)" if links and cell.folder else text
    text = f"**{text}**" if cell.strong else text
    if not cell.after:
        return text
    return f"{text}; **{cell.after}**" if cell.after_strong else f"{text}; {cell.after}"


def _effects(result: MatrixResult, row: Row) -> list[Shown]:
    line = [Shown(f"{row.id} ({UNITS[row.measure][0]})", True)]
    for column in (UNDEFENDED, *(one.id for one in result.matrix.columns)):
        text = describe_cell(result, row, column)
        after = "" if column == UNDEFENDED or text.refused else text.adaptive
        line.append(Shown(text.effect, False, text.stops, text.folder, after, bool(text.stops_adaptive)))
    return line


_COST_HEAD = (
    "defence", "stops", "without assumptions", "adaptive", "false alarms an aircraft-hour", "honest", "delay, s",
    "energy, J", "frames an aircraft-hour", "latency of frames, ms",
)  # fmt: skip


def _costs(result: MatrixResult) -> Iterator[list[Shown]]:
    for column in result.matrix.columns:
        one = cost_of(result, column)
        rate = f"{one.false_alarms / max(one.flown_h, 1e-9):.2f} ({one.false_alarms} in {one.flown_h:.1f} h)"
        texts = (
            f"{one.stopped} of {one.of}",
            f"{one.stopped_simulated} of {one.of_simulated}",
            f"{one.stopped_adaptive} of {one.of_adaptive}" if one.of_adaptive else "non-adaptive",
            rate,
            f"{one.honest_alarms} of {one.of_honest}" if one.of_honest else "–",
            _difference(one.delay),
            _difference(one.energy),
            f"{one.frames_per_h:+.0f}",
            "–" if one.latency_ms is None else f"{one.latency_ms[0]:+.2f}, {one.latency_ms[1]:+.2f}",
        )
        yield [Shown(column.id, True), *map(Shown, texts)]


def _difference(value: Interval | None) -> str:
    if value is None:
        return "–"
    text = f"{value.mean:+.2f}"
    return text if value.low is None or value.high is None else f"{text} [{value.low:+.2f}, {value.high:+.2f}]"


def _faults(result: MatrixResult, row: Row) -> list[Shown]:
    line = [Shown(f"{row.id} ({UNITS[row.measure][0]})", True)]
    for column in (UNDEFENDED, *(one.id for one in result.matrix.columns)):
        cell = result.cell(row.id, column)
        after = "" if column == UNDEFENDED or cell.refused else _alarm_rate(cell)
        line.append(Shown(format_effect(cell.effect, row.measure, False), folder=cell.folder, after=after))
    return line


def _alarm_rate(cell: Cell) -> str:
    hours = sum(cell.flown_h)
    return f"{sum(cell.fault_alarms) / hours:.1f}/h" if hours else ""


def _candidates(result: MatrixResult) -> Iterator[list[Shown]]:
    for row in attack_rows(result):
        for column in result.matrix.columns:
            for one in result.cell(row.id, column.id).adaptive:
                effect = Shown(format_effect(one.effect, row.measure), folder=one.folder)
                yield [Shown(row.id, True), Shown(column.id, True), Shown(one.candidate), effect]


def _reasons(result: MatrixResult) -> Iterator[list[Shown]]:
    for column, reason in dict.fromkeys((column, reason) for _, column, reason in refusals(result)):
        yield [Shown(column, True), Shown(reason)]
