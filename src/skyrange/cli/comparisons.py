"""Handlers of the commands that compare runs that they fly: pairs, variants of a scenario, matrices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from skyrange.cli.options import ScenarioChoice, Workers
from skyrange.cli.output.console import print_json, print_text, terminal
from skyrange.cli.output.warnings import print_failed_missions

if TYPE_CHECKING:
    from rich.console import Console

    from skyrange.study.matrix.flights import Keep, MatrixResult
    from skyrange.study.matrix.sections import Shown
    from skyrange.study.variants import Comparison
    from skyrange.twins.arms import Selection
    from skyrange.twins.pair_folder import Pair


class PairOptions(NamedTuple):
    """What `skyrange pair` was told; `arms` None are those that its number of attacks suggests."""

    scenario: ScenarioChoice
    out: Path | None
    arms: Selection | None
    honest: bool
    seeds: int
    workers: Workers
    max_runs: int


class VariantOptions(NamedTuple):
    """What `skyrange compare` was told."""

    scenario: ScenarioChoice
    variants: Sequence[str]
    out: Path | None
    seeds: int
    workers: Workers
    max_runs: int


class MatrixOptions(NamedTuple):
    """What `skyrange matrix` was told; without `rows` or `columns` all of the file."""

    file: Path | None
    out: Path | None
    rows: Sequence[str]
    columns: Sequence[str]
    seeds: int | None
    keep: Keep
    workers: Workers
    page: Path | None
    max_runs: int


def pair(options: PairOptions, *, as_json: bool) -> None:
    """`skyrange pair`."""
    from skyrange.cli.output.progress import compile_if_cold, run_progress
    from skyrange.cli.output.warnings import print_warnings
    from skyrange.study.pairing import pair as fly_pair

    scenario = options.scenario.load()
    print_warnings(scenario)
    compile_if_cold(quiet=as_json)
    with run_progress(scenario.name, quiet=as_json) as on_progress:
        result = fly_pair(
            scenario,
            options.out,
            arms=options.arms,
            honest=options.honest,
            seeds=options.seeds,
            max_runs=options.max_runs,
            executor=options.workers.executor(in_process=True),
            on_progress=on_progress,
        )
    _print_pair(result, as_json=as_json)


def _print_pair(result: Pair, *, as_json: bool) -> None:
    from skyrange.cli.output.pair_table import print_pair
    from skyrange.twins.failed_missions import require_baseline

    if as_json:
        print_json(describe_pair(result))
    else:
        print_pair(result)
    require_baseline(map(str, result.failed_missions), result.path)


def describe_pair(result: Pair) -> dict[str, Any]:
    """A pair as plain data, for `--json`."""
    from skyrange.twins.arms import HONEST

    intervals = {
        vehicle: {key: interval._asdict() for key, interval in quantities.items()}
        for vehicle, quantities in result.intervals().items()
    }
    folder = {"path": str(result.path), "report": str(result.report)}
    failed = [{**asdict(interval), "reasons": dict(interval.reasons)} for interval in result.failed_missions]
    effects, attribution = result.effects.to_pylist(), result.attribution.to_pylist()
    facts = {**result.manifest, **folder, "failed_missions": failed, "effects": effects, "intervals": intervals}
    facts["attribution"] = attribution
    return facts | ({"lie_and_truth": result.lie_and_truth.to_pylist()} if HONEST in result.arms else {})


def compare(options: VariantOptions, *, as_json: bool) -> None:
    """`skyrange compare`."""
    from skyrange.cli.output.progress import compile_if_cold, run_progress
    from skyrange.study.variants import compare_variants, read_variants

    scenario = options.scenario
    chosen = read_variants(options.variants)
    compile_if_cold(quiet=as_json)
    with run_progress(scenario.name, quiet=as_json) as on_progress:
        result = compare_variants(
            scenario.name,
            chosen,
            options.out,
            seeds=options.seeds,
            seed=scenario.seed,
            buildings=scenario.buildings,
            changes=scenario.changes,
            max_runs=options.max_runs,
            executor=options.workers.executor(in_process=True),
            on_progress=on_progress,
        )
    _print_comparison(result, as_json=as_json)


def _print_comparison(result: Comparison, *, as_json: bool) -> None:
    from skyrange.study.variants import write_comparison_report
    from skyrange.twins.failed_missions import require_baseline

    report = write_comparison_report(result)
    if as_json:
        print_json({**result.describe(), "path": str(result.path), "report": str(report)})
    else:
        print_comparison(terminal(), result)
        print_text(f"runs   {result.path}")
        print_text(f"report {report}")
    require_baseline(result.failed_missions, result.path)


def print_comparison(console: Console, result: Comparison) -> None:
    """Print the missions that failed without an attack, then the tables of a comparison."""
    from rich.table import Table

    from skyrange.study.variants import make_tables

    print_failed_missions(console, result.failed_missions)
    for shown in make_tables(result):
        table = Table(title=shown.title, title_justify="left", title_style="bold")
        for number, text in enumerate(shown.head):
            table.add_column(text, justify="right" if number else "left")
        for row in shown.rows:
            table.add_row(*row)
        console.print(table)


def matrix(options: MatrixOptions, *, as_json: bool) -> None:
    """`skyrange matrix`."""
    from skyrange.cli.output.progress import compile_if_cold, run_progress
    from skyrange.core.errors import InputError
    from skyrange.study.matrix.flights import fly_matrix
    from skyrange.study.matrix.model import read_matrix, select

    whole = read_matrix(options.file)
    chosen = select(whole, tuple(options.rows), tuple(options.columns))
    flown = {row.id for row in chosen.rows}
    other_rows = [row for row in whole.rows if row.id not in flown]
    if options.seeds is not None:
        chosen = chosen.model_copy(update={"seeds": options.seeds})
    page = options.page
    if page is not None and not page.parent.is_dir():
        raise InputError.one("matrix", "--page", str(page), "a file in a folder that exists")
    compile_if_cold(quiet=as_json)
    executor = options.workers.executor(in_process=True)
    with run_progress(chosen.name, quiet=as_json) as on_progress:
        result = fly_matrix(
            chosen,
            options.out,
            keep=options.keep,
            executor=executor,
            on_progress=on_progress,
            other_rows=other_rows,
            max_runs=options.max_runs,
        )
    _print_matrix(result, page, as_json=as_json)


def _print_matrix(result: MatrixResult, page: Path | None, *, as_json: bool) -> None:
    from skyrange.study.matrix.flights import describe
    from skyrange.study.matrix.page import write_matrix_page, write_matrix_report
    from skyrange.twins.failed_missions import require_baseline

    report = write_matrix_report(result)
    if page is not None:
        write_matrix_page(result, page)
    if as_json:
        print_json(describe(result))
    else:
        print_matrix(terminal(), result)
        print_text(f"matrix {result.path}")
        print_text(f"report {report}")
    require_baseline(result.failed_missions, result.path)


def resume(folder: Path, workers: Workers, *, other_version: bool, as_json: bool) -> None:
    """`skyrange resume`."""
    from skyrange.cli.options import load_plugins
    from skyrange.cli.output.log_parity import show_log_parity
    from skyrange.cli.output.progress import compile_if_cold, run_progress
    from skyrange.parity.logs.comparison import resume_log_parity
    from skyrange.parity.logs.plan import KIND as LOG_PARITY
    from skyrange.study.execution.store import open_store
    from skyrange.study.matrix.flights import resume_matrix
    from skyrange.study.pairing import resume_pair
    from skyrange.study.variants import resume_comparison

    store = open_store(folder)
    if other_version:
        store = store.allow_version()
    load_plugins(store.plugins)
    compile_if_cold(quiet=as_json)
    if store.kind == "study":
        from skyrange.cli.studies import resume_study

        resume_study(folder, workers, as_json=as_json)
        return
    executor = workers.executor(in_process=True)
    with run_progress(store.name, quiet=as_json) as on_progress:
        if store.kind == "pair":
            show = partial(_print_pair, resume_pair(store, executor, on_progress))
        elif store.kind == "compare":
            show = partial(_print_comparison, resume_comparison(store, executor, on_progress))
        elif store.kind == LOG_PARITY:
            show = partial(show_log_parity, resume_log_parity(store, executor, on_progress))
        else:
            show = partial(_print_matrix, resume_matrix(store, executor, on_progress), None)
    show(as_json=as_json)


def print_matrix(console: Console, result: MatrixResult) -> None:
    """Print the missions that failed without an attack, whether the seeds are too few for a claim, and every section of
    a matrix as a table.
    """
    from rich.table import Table
    from rich.text import Text

    from skyrange.study.matrix.sections import describe_quick_look, make_sections

    def text_of(cell: Shown) -> Text:
        text = Text(cell.text, style="bold" if cell.strong else "")
        if cell.after:
            text.append(f"\n{cell.after}", style="bold" if cell.after_strong else "dim")
        return text

    print_failed_missions(console, result.failed_missions)
    if quick_look := describe_quick_look(result):
        console.print(Text(quick_look, style="bold"))
    for section in make_sections(result):
        table = Table(title=section.title, title_justify="left", title_style="bold", show_lines=True)
        for name in section.head:
            table.add_column(name)
        for row in section.rows:
            table.add_row(*map(text_of, row))
        console.print(table)
