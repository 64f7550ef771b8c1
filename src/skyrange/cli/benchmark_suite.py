"""The commands `skyrange bench all` and `skyrange bench page`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from skyrange.cli.output.console import print_json, print_notice, print_text
from skyrange.cli.output.progress import compile_if_cold, step_progress

if TYPE_CHECKING:
    from skyrange.bench.suite.results import Results


def run_all(names: Sequence[str], quick: bool, output: Path | None, page: Path | None, as_json: bool) -> None:
    """`skyrange bench all`. With `--json` the progress still goes to standard error, because it takes minutes."""
    from skyrange.bench.suite.execution import run_benchmarks
    from skyrange.bench.suite.page import write_page
    from skyrange.bench.suite.results import write_results
    from skyrange.core.errors import ComponentError

    for option, path in (("--output", output), ("--page", page)):
        _check_folder("bench all", option, path)
    compile_if_cold(quiet=False)
    with step_progress(quiet=False) as on_case:
        results = run_benchmarks(names, quick=quick, on_case=on_case)
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
        what = "; ".join(f"{benchmark.name}, {case.name}: {case.failed}" for benchmark, case in failed)
        raise ComponentError("bench all", f"{len(failed)} cases failed: {what}")


def make_page(path: Path, against: Path | None, output: Path | None) -> None:
    """`skyrange bench page`."""
    from skyrange.bench.suite.comparison import compare_results, list_differences
    from skyrange.bench.suite.page import write_page
    from skyrange.bench.suite.results import read_results
    from skyrange.core.errors import InputError

    written = output or path.with_suffix(".html")
    results = read_results(path)
    old = None if against is None else read_results(against)
    _check_folder("bench page", "--output", written)
    if old is not None:
        if not compare_results(old, results):
            expected = f"results with a case that {path} has too, of the same size"
            raise InputError.one("bench page", "--against", str(against), expected)
        for line in list_differences(old, results):
            print_notice(f"warning: {line}")
    write_page(results, written, old)
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
