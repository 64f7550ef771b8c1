"""Matrix of attacks and defences on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skyrange.cli.output.warnings import print_failed_missions
from skyrange.study.matrix.sections import make_sections

if TYPE_CHECKING:
    from rich.console import Console

    from skyrange.study.matrix.flights import MatrixResult
    from skyrange.study.matrix.sections import Shown


def print_matrix(console: Console, result: MatrixResult) -> None:
    """Print the missions that failed without an attack, then every section of a matrix as a table."""
    from rich.table import Table
    from rich.text import Text

    def text_of(cell: Shown) -> Text:
        text = Text(cell.text, style="bold" if cell.strong else "")
        if cell.after:
            text.append(f"\n{cell.after}", style="bold" if cell.after_strong else "dim")
        return text

    print_failed_missions(console, result.failed_missions)
    for section in make_sections(result):
        table = Table(title=section.title, title_justify="left", title_style="bold", show_lines=True)
        for name in section.head:
            table.add_column(name)
        for row in section.rows:
            table.add_row(*map(text_of, row))
        console.print(table)
