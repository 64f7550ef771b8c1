"""The page of a comparison with logs, and its tables in a Markdown page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from skyrange.core.files import atomic_write
from skyrange.parity.logs.comparison import LogParity
from skyrange.parity.logs.figures import COLOURS, draw_heights, draw_leans, draw_way
from skyrange.parity.logs.tables import NAMES, TextTable, describe_result, list_tables, tabulate_quantities
from skyrange.report.marked_page import MarkedPart
from skyrange.report.rendering import asset, content_policy, render

PAGE: Final = "parity.html"
TABLES: Final = MarkedPart("<!-- skyrange parity log: begin -->", "<!-- skyrange parity log: end -->")


def write_page(result: LogParity) -> Path:
    """Write the page of a comparison into its folder; its path."""
    path = result.path / PAGE
    with atomic_write(path) as file:
        file.write(render_page(result).encode())
    return path


def render_page(result: LogParity) -> str:
    """The page as HTML."""
    style = asset("style.css")
    plan = result.plan
    return str(
        render(
            "flightlog/parity.html.jinja",
            policy=content_policy(style),
            title="simulated and real flights · skyrange",
            style=style,
            verdict=describe_result(result),
            keys=[{"name": NAMES[name], "colour": COLOURS[name]} for name in plan.seeds],
            tables=[*list_tables(result), tabulate_quantities()],
            flights=[
                {
                    "name": told["name"],
                    "estimates": told["estimates"],
                    "figures": [draw(shown) for draw in (draw_way, draw_heights, draw_leans)],
                }
                for told in plan.flights
                if (shown := [flight for flight in result.flights if flight.name == told["name"]])
            ],
            unjudged=list(plan.unjudged.items()),
        )
    )


def renew_page(result: LogParity, page: Path) -> None:
    """Renew `TABLES` in a Markdown page. Raises `InputError` for a page without its marks."""
    TABLES.write(page, _write_lines(result))


def _write_lines(result: LogParity) -> Iterator[str]:
    yield describe_result(result)
    yield ""
    for table in list_tables(result):
        yield f"**{table.title}.** {table.lead}"
        yield ""
        yield from _write_table(table)
        yield ""
    if result.plan.unjudged:
        yield "Not judged: " + "; ".join(f"{name} ({reason})" for name, reason in result.plan.unjudged.items()) + "."
        yield ""


def _write_table(table: TextTable) -> Iterator[str]:
    yield f"| {' | '.join(table.head)} |"
    yield f"|{'---|' * len(table.head)}"
    for row in table.rows:
        yield f"| {' | '.join(cell.replace('|', '/') for cell in row)} |"
