"""Report of a matrix as one HTML file: figure and tables, whose cells lead to the reports of their pairs."""

from __future__ import annotations

from pathlib import Path

from skyrange.core.files import atomic_write
from skyrange.report.rendering import asset, content_policy, render
from skyrange.study.matrix.figure import draw_matrix
from skyrange.study.matrix.flights import MatrixResult
from skyrange.study.matrix.sections import introduce, make_sections, write_markdown

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
    for name, text in ((REPORT, str(page)), (PAGE, write_markdown(result, "", FIGURE, True))):
        with atomic_write(result.path / name) as file:
            file.write(text.encode())
    return result.path / REPORT


def write_matrix_page(result: MatrixResult, page: Path) -> None:
    """Write the page in Markdown into `page`, without links to reports, and its figure beside it."""
    draw_matrix(result).save(page.with_suffix(".svg"))
    text = write_markdown(result, "Attacks and defences", page.with_suffix(".svg").name, False)
    with atomic_write(page) as file:
        file.write(text.encode())


def _plain(text: str) -> str:
    """A text without marks of Markdown."""
    return text.replace("*", "").replace("`", "")
