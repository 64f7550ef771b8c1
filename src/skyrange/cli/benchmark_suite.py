"""The commands `skyrange bench all` and `skyrange bench page`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyrange.cli.options import AsJson
from skyrange.cli.output.console import print_json, print_notice, print_text
from skyrange.cli.output.progress import compile_if_cold, step_progress

if TYPE_CHECKING:
    from skyrange.bench.suite.results import Results


commands = typer.Typer()


@commands.command("all", epilog="Example: skyrange bench all --quick --output results.json --page results.html")
def all_benches(
    *,
    quick: Annotated[
        bool, typer.Option("--quick", help="Smaller sizes: about a minute instead of five, and less to rely on.")
    ] = False,
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Run this benchmark, such as fleet-light. May be repeated. Default: all."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the results to this file as JSON, for bench page.")
    ] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a page of the results to this HTML file.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Run all benchmarks in turn, with ratios to a yardstick, load of the machine and memory over time."""
    from skyrange.bench.suite.execution import run_benchmarks
    from skyrange.bench.suite.page import write_page
    from skyrange.bench.suite.results import write_results
    from skyrange.core.errors import ComponentError

    for option, path in (("--output", output), ("--page", page)):
        _check_folder("bench all", option, path)
    compile_if_cold(quiet=False)
    with step_progress(quiet=False) as on_case:
        results = run_benchmarks(only or [], quick=quick, on_case=on_case)
    if output is not None:
        write_results(results, output)
    if page is not None:
        write_page(results, page)
    if as_json:
        print_json(results.model_dump(mode="json"))
    else:
        _print_results(results)
        for name, path in (("results", output), ("page", page)):
            if path is not None:
                print_text(f"{name} {path}")
    if failed := results.failures():
        failures = "; ".join(f"{benchmark.name}, {case.name}: {case.failed}" for benchmark, case in failed)
        raise ComponentError("bench all", f"{len(failed)} cases failed: {failures}")


@commands.command("page", epilog="Example: skyrange bench page new.json --against old.json --output comparison.html")
def results_page(
    *,
    results: Annotated[
        Path, typer.Argument(metavar="RESULTS", help="Results of bench all, a JSON file.", show_default=False)
    ],
    against: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Older results to compare with: old, new and their ratios.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="HTML file to write. Default: beside the results.")
    ] = None,
) -> None:
    """Write a page of the results of bench all, alone or compared with older ones."""
    from skyrange.bench.suite.comparison import compare_results, list_differences
    from skyrange.bench.suite.page import write_page
    from skyrange.bench.suite.results import read_results
    from skyrange.core.errors import InputError

    written = output or results.with_suffix(".html")
    measured = read_results(results)
    old = None if against is None else read_results(against)
    _check_folder("bench page", "--output", written)
    if old is not None:
        if not compare_results(old, measured):
            expected = f"results with a case that {results} has too, of the same size"
            raise InputError.one("bench page", "--against", str(against), expected)
        for line in list_differences(old, measured):
            print_notice(f"warning: {line}")
    write_page(measured, written, old)
    print_text(f"page {written}")


def _check_folder(who: str, option: str, path: Path | None) -> None:
    """Raise `InputError` if a file cannot be there, before minutes are spent."""
    from skyrange.core.errors import InputError

    if path is not None and (path.is_dir() or not path.parent.is_dir()):
        raise InputError.one(who, option, str(path), "a file in a folder that exists")


def _print_results(results: Results) -> None:
    """Print a line for each case, the machine, the reasons of what was skipped, and what speaks against the figures."""
    from skyrange.bench.suite.comparison import list_warnings
    from skyrange.bench.suite.tables import list_facts, list_skipped, make_overview

    made = make_overview(results)
    for name, *values in (made.head, *made.rows):
        print_text(" ".join(f"{value:>10}" for value in values) + f"  {name}")
    for name, value in (*list_facts(results), *((f"{name} skipped", why) for name, why in list_skipped(results))):
        print_text(f"{name}: {value}")
    for line in list_warnings(results):
        print_notice(f"warning: {line}")
