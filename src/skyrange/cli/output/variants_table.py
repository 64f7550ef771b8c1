"""Comparison of variants on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skyrange.cli.output.warnings import print_failed_missions
from skyrange.study.variants import make_tables

if TYPE_CHECKING:
    from rich.console import Console

    from skyrange.study.variants import Comparison


def print_comparison(console: Console, result: Comparison) -> None:
    """Print the missions that failed without an attack, then the tables of a comparison."""
    from rich.table import Table

    print_failed_missions(console, result.failed_missions)
    for one in make_tables(result):
        table = Table(title=one.title, title_justify="left", title_style="bold")
        for number, text in enumerate(one.head):
            table.add_column(text, justify="right" if number else "left")
        for row in one.rows:
            table.add_row(*row)
        console.print(table)
