"""Page of a matrix: a figure of the effects that are left, and tables that lead to the reports of the pairs."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from skyrange.core.files import atomic_write
from skyrange.figures import svg
from skyrange.figures.svg import Figure
from skyrange.report.rendering import asset, content_policy, render
from skyrange.study.matrix.flights import MatrixResult
from skyrange.study.matrix.sections import introduce, make_sections, write_markdown
from skyrange.study.matrix.summary import CellText, attack_rows, describe_cell

_LEFT, _TOP, _WIDE, _HIGH, _FOOT = 190.0, 118.0, 64.0, 34.0, 34.0
_HARM: Final = "#b3261e"
_SAFE: Final = "#0b7a43"


def draw_matrix(result: MatrixResult) -> Figure:
    """A table of colours: green where nothing is left of the effect, red where all of it is; a dot marks an alarm.

    The lower right corner of a cell is the adaptive adversary's share, where one knows the defence.
    """
    rows, columns = attack_rows(result), result.matrix.columns
    width, height = max(_LEFT + _WIDE * len(columns) + 60, 640.0), _TOP + _HIGH * len(rows) + _FOOT
    body = []
    for k, column in enumerate(columns):
        x = _LEFT + _WIDE * (k + 0.5)
        turn = {"transform": f"rotate(-38 {svg.format_number(x)} {svg.format_number(_TOP - 10)})"}
        body.append(svg.label(x, _TOP - 10, column.id, "start", extra=turn))
    for n, row in enumerate(rows):
        y = _TOP + _HIGH * n
        body.append(svg.label(_LEFT - 10, y + _HIGH / 2 + 4, row.id, "end"))
        for k, column in enumerate(columns):
            x = _LEFT + _WIDE * k
            text = describe_cell(result, row, column.id)
            place: svg.Attributes = {"x": x + 1, "y": y + 1, "width": _WIDE - 2, "height": _HIGH - 2, "rx": 3}
            if text.share is None:
                why = "cannot be declared here" if text.refused else "no effect without a defence"
                body.append(svg.element("rect", {**place, **svg.GRID}, svg.title(f"{row.id}, {column.id}: {why}")))
                body.append(svg.label(x + _WIDE / 2, y + _HIGH / 2 + 4, "–", extra={"opacity": ".5"}))
                continue
            said = f"{row.id}, {column.id}: {text.effect}; adaptive {text.adaptive}; alarm {text.alarm}"
            shown = {**place, "fill": _colour(text.share), "fill-opacity": _opacity(text.share)}
            body.append(svg.element("rect", shown, svg.title(said)))
            cell = result.cell(row.id, column.id)
            best = cell.best_adaptive
            undefended = 0.0 if best is None else sum(result.cell(row.id).effects[-len(best.effects) :])
            if best is not None and undefended:
                share = sum(best.effects) / undefended
                right, low = x + _WIDE - 2, y + _HIGH - 2
                corner = f"M{right:.1f} {low - 14:.1f}V{low:.1f}H{right - 22:.1f}Z"
                body.append(svg.element("path", {"d": corner, "fill": _colour(share)}))
            percent = f"{min(100 * text.share, 999):.0f} %"
            body.append(svg.label(x + _WIDE / 2 - 4, y + _HIGH / 2 + 4, percent, extra=_style(text)))
            if any(at is not None for at in cell.alarms_s):
                body.append(svg.element("circle", {"cx": x + 9, "cy": y + 9, "r": 3.2, "fill": "currentColor"}))
    foot = "share of the undefended effect · bold: stops · italic: in every flight · dot: alarm · corner: adaptive"
    body.append(svg.label(width - 12, height - 12, foot, "end", 10.5, {"opacity": ".7"}))
    return svg.document(width, height, f"Attacks and defences: {result.matrix.name}", body)


def _style(text: CellText) -> svg.Attributes | None:
    return svg.BOLD if text.stops else {"font-style": "italic"} if text.in_every_flight else None


def _colour(share: float) -> str:
    return _SAFE if share <= 0.5 else _HARM


def _opacity(share: float) -> float:
    """Stronger towards both ends: nothing left, or all of it."""
    return round(0.15 + 0.5 * min(abs(share - 0.5) / 0.5, 1.0), 2)


REPORT = "report.html"
PAGE = "matrix.md"
FIGURE = "matrix.svg"


def write_matrix_report(result: MatrixResult) -> Path:
    """Write `report.html`, `matrix.md` and `matrix.svg` into the matrix's folder; returns the report."""
    figure = draw_matrix(result)
    figure.save(result.path / FIGURE)
    style = asset("style.css")
    page = render(
        "matrix/page.html.jinja",
        policy=content_policy(style),
        title=f"{result.matrix.name} · attacks and defences · skyrange",
        style=style,
        name=result.matrix.name,
        failed=result.failed_missions,
        introduction=_plain(introduce(result).replace("[pair](pair-folder.md)", "pair")),
        figure=figure,
        sections=[section._replace(text=_plain(section.text)) for section in make_sections(result)],
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
