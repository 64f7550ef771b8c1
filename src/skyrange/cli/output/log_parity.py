"""Output of a comparison with logs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table

from skyrange.cli.output.console import print_json, print_text, terminal

if TYPE_CHECKING:
    from skyrange.parity.logs.comparison import LogParity


def show_log_parity(result: LogParity, *, as_json: bool) -> None:
    """Write the page of a comparison, and print what it says, what is not judged first."""
    from skyrange.parity.logs.page import write_page
    from skyrange.parity.logs.tables import describe_result, list_tables

    page = write_page(result)
    if as_json:
        print_json(result.describe())
        return
    for name, reason in result.plan.unjudged.items():
        print_text(f"not judged: {name}: {reason}")
    print_text(describe_result(result))
    for table in list_tables(result):
        shown = Table(title=table.title, title_justify="left", title_style="bold")
        for column in table.head:
            shown.add_column(column)
        for row in table.rows:
            shown.add_row(*row)
        terminal().print(shown)
    print_text(f"page   {page}")
