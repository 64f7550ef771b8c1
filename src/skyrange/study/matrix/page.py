"""Page of a matrix: a figure of the effects that are left, and tables that lead to the reports of the pairs."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import quote

from skyrange.core.files import atomic_write
from skyrange.figures import svg
from skyrange.figures.svg import Figure
from skyrange.report.rendering import asset, content_policy, render, table_script
from skyrange.study.matrix.flights import MatrixResult
from skyrange.study.matrix.model import UNDEFENDED, Row
from skyrange.study.matrix.sections import EFFECT, describe_quick_look, introduce, make_sections, write_markdown
from skyrange.study.matrix.states import SIGNS, State, count_missions, describe_cells, find_state
from skyrange.study.matrix.summary import UNITS, attack_rows, describe_cell

_LEFT, _TOP, _WIDE, _HIGH, _FOOT = 190.0, 136.0, 66.0, 34.0, 84.0
_OPACITY: Final = ".3"
_WIDE_SECTION: Final = 9
"""A section with more columns is shown by row, because its table would be wider than a page."""


def draw_matrix(result: MatrixResult) -> Figure:
    """A table of colours and signs of the states of cells, with the share of the undefended effect that is left.

    The lower right corner of a cell is the adaptive adversary's share, where one knows the defence; a dot marks an
    alarm.
    """
    rows, columns = attack_rows(result), result.matrix.columns
    width, height = max(_LEFT + _WIDE * len(columns) + 60, 880.0), _TOP + _HIGH * len(rows) + _FOOT
    body = []
    for k, column in enumerate(columns):
        x = _LEFT + _WIDE * (k + 0.5)
        turn = {"transform": f"rotate(-38 {svg.format_number(x)} {svg.format_number(_TOP - 10)})"}
        body.append(svg.label(x, _TOP - 10, column.id, "start", extra=turn))
    for n, row in enumerate(rows):
        y = _TOP + _HIGH * n
        body.append(svg.label(_LEFT - 10, y + _HIGH / 2 + 4, row.id, "end"))
        for k, column in enumerate(columns):
            x, sign = _LEFT + _WIDE * k, SIGNS[find_state(result, row.id, column.id)]
            heat = _heat_cell(result, row, column.id)
            place: svg.Attributes = {"x": x + 1, "y": y + 1, "width": _WIDE - 2, "height": _HIGH - 2, "rx": 3}
            body.append(
                svg.element("rect", {**place, "fill": sign.ink, "fill-opacity": _OPACITY}, svg.title(heat.title))
            )
            body.append(svg.label(x + 6, y + 15, heat.share or sign.sign, "start", extra=_style(heat)))
            if heat.share:
                body.append(svg.label(x + _WIDE - 6, y + 15, sign.sign, "end", 10, svg.BOLD))
            if heat.adaptive:
                body.append(svg.label(x + 6, y + 28, f"kn. {heat.adaptive}", "start", 9))
            if heat.alarmed:
                body.append(svg.element("circle", {"cx": x + _WIDE - 9, "cy": y + 25, "r": 3, "fill": "currentColor"}))
    for k, sign in enumerate(SIGNS.values()):
        x, y = 8 + k % 3 * (width - 16) / 3, height - 60 + 15 * (k // 3)
        place = {"x": x, "y": y - 9, "width": 11, "height": 11, "rx": 2}
        body.append(svg.element("rect", {**place, "fill": sign.ink, "fill-opacity": _OPACITY}))
        body.append(svg.label(x + 16, y, f"{sign.sign}  {sign.meaning}", "start", 9.5))
    foot = "percent: of the undefended effect · kn.: an adversary who knows the defence · dot: alarm"
    body.append(svg.label(8, height - 12, foot, "start", 9.5))
    return svg.document(width, height, f"Attacks and defences: {result.matrix.name}", body)


class HeatCell(NamedTuple):
    """One cell of the page's first table."""

    state: State
    sign: str
    meaning: str
    share: str
    """Of the undefended effect, in percent; "" where there is none."""
    adaptive: str
    alarmed: bool
    title: str
    strong: bool
    slanted: bool
    href: str


def _heat_cell(result: MatrixResult, row: Row, column: str) -> HeatCell:
    text, cell, state = (
        describe_cell(result, row, column),
        result.cell(row.id, column),
        find_state(result, row.id, column),
    )
    best = cell.best_adaptive
    undefended = 0.0 if best is None else sum(result.cell(row.id).effects[-len(best.effects) :])
    lost = sum(not complete for complete in cell.complete)
    parts = [
        f"{row.id}, {column}: {SIGNS[state].meaning}",
        *([f"effect {text.effect}"] if text.share is not None else []),
        *([f"missions lost in {lost} of {len(cell.complete)} runs"] if lost else []),
        *([f"adversary who knows it {text.adaptive}"] if best is not None else []),
        *([f"alarm {text.alarm}"] if text.alarm not in ("–", "none") else []),
    ]
    return HeatCell(
        state,
        SIGNS[state].sign,
        SIGNS[state].meaning,
        "" if text.share is None or state is State.IDLE else _percent(text.share),
        _percent(sum(best.effects) / undefended) if best is not None and undefended else "",
        any(at is not None for at in cell.alarms_s),
        "; ".join(parts),
        text.stops,
        text.in_every_flight,
        f"#{_anchor(row.id, column)}",
    )


def _percent(share: float) -> str:
    return f"{min(100 * share, 999):.0f} %"


def _anchor(row: str, column: str) -> str:
    return f"cell-{quote(row)}-{quote(column)}"


def _style(cell: HeatCell) -> svg.Attributes | None:
    return svg.BOLD if cell.strong else {"font-style": "italic"} if cell.slanted else None


def _details(result: MatrixResult) -> Iterator[Mapping[str, Any]]:
    """The cells of each attack in words, and where their flights are."""
    for row in attack_rows(result):
        shown = []
        for column in (UNDEFENDED, *(column.id for column in result.matrix.columns)):
            text = describe_cell(result, row, column)
            state = None if column == UNDEFENDED else find_state(result, row.id, column)
            flown = not text.refused and state is not State.IDLE
            shown.append(
                {
                    "column": column,
                    "anchor": _anchor(row.id, column),
                    "state": state,
                    "sign": "" if state is None else SIGNS[state].sign,
                    "meaning": "" if state is None else SIGNS[state].meaning,
                    "text": text,
                    "command": "" if text.folder or not flown else _command(result.path, row.id, column),
                }
            )
        yield {"id": row.id, "unit": UNITS[row.measure][0], "undefended": shown[0]["text"], "cells": shown}


def _command(folder: Path, row: str, column: str) -> str:
    """The command that flies a cell again whose flights were not kept, and shows them."""
    return f"skyrange watch {shlex.quote(str(folder))} --run {shlex.quote(f'{row}/{column}')}"


REPORT = "report.html"
PAGE = "matrix.md"
FIGURE = "matrix.svg"


def write_matrix_report(result: MatrixResult) -> Path:
    """Write `report.html`, `matrix.md` and `matrix.svg` into the matrix's folder; returns the report."""
    figure = draw_matrix(result)
    figure.save(result.path / FIGURE)
    style, script = asset("style.css"), table_script()
    done, all_missions = count_missions(result)
    attacks = attack_rows(result)
    page = render(
        "matrix/page.html.jinja",
        policy=content_policy(style, script),
        title=f"{result.matrix.name} · attacks and defences · skyrange",
        style=style,
        script=script,
        name=result.matrix.name,
        failed=result.failed_missions,
        missions=f"{done} of {all_missions} missions complete without an attack",
        pill="ok" if done == all_missions else "bad",
        verdict=describe_cells(result),
        quick_look=describe_quick_look(result),
        introduction=_plain(introduce(result).replace("[pair](pair-folder.md)", "pair")),
        columns=[column.id for column in result.matrix.columns],
        heat=[(row.id, [_heat_cell(result, row, column.id) for column in result.matrix.columns]) for row in attacks],
        signs=[(state, sign) for state, sign in SIGNS.items()],
        details=list(_details(result)),
        wide=_WIDE_SECTION,
        sections=[
            section._replace(text=_plain(section.text)) for section in make_sections(result) if section.title != EFFECT
        ],
    )
    for name, text in ((REPORT, str(page)), (PAGE, write_markdown(result, "", FIGURE, links=True))):
        with atomic_write(result.path / name) as file:
            file.write(text.encode())
    return result.path / REPORT


def write_matrix_page(result: MatrixResult, page: Path) -> None:
    """Write the page in Markdown into `page`, without links to reports, and its figure beside it."""
    draw_matrix(result).save(page.with_suffix(".svg"))
    text = write_markdown(result, "Attacks and defences", page.with_suffix(".svg").name, links=False)
    with atomic_write(page) as file:
        file.write(text.encode())


def _plain(text: str) -> str:
    """A text without marks of Markdown."""
    return text.replace("*", "").replace("`", "")
