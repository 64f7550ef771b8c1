"""The commands `skyrange study`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skyrange.cli.options import AsJson, Jobs, On, OtherVersion, Plugins, Workers, load_plugins
from skyrange.cli.output.console import print_json, print_notice, print_text, terminal

if TYPE_CHECKING:
    from skyrange.statistics.means import Interval
    from skyrange.study.design.model import Study
    from skyrange.study.execution.executors import Executor
    from skyrange.study.execution.storage import BlockStorage
    from skyrange.study.folder import StudyFolder
    from skyrange.study.study_run import StudyResult

study_app = typer.Typer(
    help="Fly many runs of a scenario, by factors, arms and seeds, and measure them.\n\n"
    "Example: skyrange study run study.toml",
    no_args_is_help=True,
)

StudyFile = Annotated[
    Path,
    typer.Argument(
        metavar="NAME|FILE", help="Name of a shipped study (detectors), or a TOML file.", show_default=False
    ),
]

Folder = Annotated[Path, typer.Argument(metavar="STUDY", help="The folder of a study.", show_default=False)]

Changes = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="PATH=VALUE",
        help="Change a value of the study's file, such as seeds=2 or factors.size.values=[1,2]; * in the path matches "
        "all elements. May be repeated.",
    ),
]

Storage = Annotated[
    str | None,
    typer.Option(
        "--storage",
        metavar="URL",
        help="Storage through which the nodes of a cluster return what they flew, if they do not see the folder of the "
        "study: a URL that fsspec knows, such as s3://bucket/drift.",
        show_default=False,
    ),
]

_SHOWN = 10
"""Failed blocks that are listed on the terminal."""


def find_storage(workers: Workers, url: str | None) -> BlockStorage | None:
    """The storage at a URL between this machine and a cluster. Raises `InputError` without a cluster."""
    from skyrange.core.errors import InputError
    from skyrange.study.execution.storage import BlockStorage

    if url is None:
        return None
    if workers.cluster is None:
        raise InputError.one("study", "--storage", url, "none without --on: this machine writes to the study's folder")
    return BlockStorage(url)


@study_app.command("run", epilog="Example: skyrange study run study.toml --dry-run")
def run(
    *,
    file: StudyFile,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the study. Default: studies/NAME.", show_default=False)
    ] = None,
    changes: Changes = None,
    jobs: Jobs = None,
    on: On = None,
    storage: Storage = None,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Check all scenarios, fly one block as a trial, and estimate time and disk."),
    ] = False,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Fly a study: every point of its design with every seed in every arm. A study that was begun is continued."""
    load_plugins(plugin)
    from skyrange.cli.output.progress import compile_if_cold, run_progress
    from skyrange.study.design.model import read_study
    from skyrange.study.study_run import run_study

    study = read_study(file, changes or [])
    workers = Workers(jobs, on)
    compile_if_cold(quiet=as_json)
    if dry_run:
        _estimate(study, workers, as_json=as_json)
        return
    place, executor = find_storage(workers, storage), workers.executor()
    with run_progress(study.name, quiet=as_json) as on_progress:
        result = run_study(study, out, executor=executor, on_progress=on_progress, storage=place)
    _print_result(result, as_json=as_json)


@study_app.command("register", epilog="Example: skyrange study register study.toml")
def register(
    *,
    file: StudyFile,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the study. Default: studies/NAME.", show_default=False)
    ] = None,
    changes: Changes = None,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Register a study before its flights: its question, measures and rule, with a hash to publish.

    The report of the study says what was registered; all else is exploratory.
    """
    load_plugins(plugin)
    from skyrange.study.design.model import read_study
    from skyrange.study.registration import register_study

    folder, registered = register_study(read_study(file, changes or []), out)
    if as_json:
        print_json({"folder": str(folder.path), **registered._asdict()})
        return
    print_text(f"registered {folder.study.name} on {registered.registered_utc}: {folder.path / 'registration.json'}")
    print_text(f"to publish, SHA-256: {registered.hash}")
    print_text(f"to fly it: skyrange study run {file} --out {folder.path}")


@study_app.command("resume", epilog="Example: skyrange study resume studies/drift")
def resume(
    *,
    folder: Folder,
    jobs: Jobs = None,
    on: On = None,
    storage: Storage = None,
    other_version: OtherVersion = False,
    retry: Annotated[bool, typer.Option("--retry", help="Also fly the blocks with failed runs again.")] = False,
    plugin: Plugins = None,
    as_json: AsJson = False,
) -> None:
    """Fly the blocks of a study that are not finished."""
    from skyrange.study.execution.store import open_store

    load_plugins(plugin)
    store = open_store(folder, "study")
    if other_version:
        store.allow_version()
    load_plugins(store.plugins)
    resume_study(folder, Workers(jobs, on), storage, retry=retry, as_json=as_json)


def resume_study(
    folder: Path,
    workers: Workers,
    storage: str | None = None,
    *,
    retry: bool = False,
    as_json: bool,
) -> None:
    """Go on with a study, whose plugins are loaded."""
    from skyrange.study.execution.plan_run import forget_failures
    from skyrange.study.folder import open_folder, require_unchanged

    study = open_folder(folder)
    require_unchanged(study)
    place = find_storage(workers, storage)
    if retry:
        forget_failures(study.store, place)
    _fly(study, workers.executor(), place, as_json=as_json)


@study_app.command("status", epilog="Example: skyrange study status studies/drift")
def status(*, folder: Folder, as_json: AsJson = False) -> None:
    """Print how many blocks of a study are finished, and which runs failed."""
    from skyrange.study.folder import open_folder
    from skyrange.study.study_run import list_failures

    opened = open_folder(folder)
    finished, failures = len(opened.finished()), list_failures(opened)
    if as_json:
        data: dict[str, Any] = {"study": opened.study.name, "blocks": len(opened.blocks), "finished": finished}
        print_json({**data, "failed": [{"block": block, "error": error} for block, error in failures]})
        return
    arms = len(opened.study.arms)
    print_text(f"{opened.study.name}: {finished} of {len(opened.blocks)} blocks of {arms} runs are finished")
    _print_failures(failures)
    if finished < len(opened.blocks):
        print_text(f"to go on: skyrange study resume {opened.path}")


@study_app.command("show", epilog="Example: skyrange study show studies/drift")
def show(*, folder: Folder, as_json: AsJson = False) -> None:
    """Print what each arm measured at each point: means over the seeds, with 95 % confidence intervals."""
    from rich.table import Table

    from skyrange.study.folder import open_folder
    from skyrange.study.registration import QUANTITIES
    from skyrange.study.results import write_results
    from skyrange.study.summary import read_samples, summarise_study, tells_something

    opened = open_folder(folder)
    write_results(opened)
    cells = summarise_study(opened)
    if as_json:
        rows = [
            {**cell._asdict(), "means": {name: mean._asdict() for name, mean in cell.means.items()}} for cell in cells
        ]
        print_json({"study": opened.study.name, "cells": rows})
        return
    samples = read_samples(folder)
    shown = [quantity for quantity in QUANTITIES if tells_something(quantity, samples)]
    table = Table(title=opened.study.name, title_justify="left", title_style="bold")
    names = [factor.name for factor in opened.study.factors]
    for name in (*names, "arm", "runs", "measure", "mean", "95 % interval"):
        table.add_column(name)
    for cell in cells:
        runs = str(cell.runs) if not cell.failed else f"{cell.runs}, {cell.failed} failed"
        head = [*map(_short, cell.values.values()), cell.arm, runs]
        for quantity in shown:
            if quantity.name in cell.means:
                name, unit = quantity.name, quantity.unit
                measure = f"{name.removesuffix(f'_{unit}')}, {unit}" if unit else name
                table.add_row(*head, measure, *_interval(cell.means[name]))
                head = [""] * len(head)
    terminal().print(table)


@study_app.command("report", epilog="Example: skyrange study report studies/drift")
def report(
    *,
    folder: Folder,
    pdf: Annotated[bool, typer.Option("--pdf", help="Write the figures as PDF as well, for papers.")] = False,
) -> None:
    """Write report.html: effects with intervals, dose-response curves, interactions, failures; and figures as SVG."""
    from skyrange.study.page import write_study_report

    print_text(f"report {write_study_report(folder, pdf=pdf)}")


@study_app.command("score", epilog="Example: skyrange study score studies/detect --hold-out-family gnss_denial")
def score(
    *,
    folder: Folder,
    rate: Annotated[
        float,
        typer.Option(metavar="N", min=1e-6, help="False alarms per aircraft-hour to choose thresholds for."),
    ] = 1.0,
    hold_out_family: Annotated[
        list[str] | None,
        typer.Option(metavar="FAMILY", help="Family of attacks that only the test split has. May be repeated."),
    ] = None,
    hold_out_city: Annotated[
        list[str] | None, typer.Option(metavar="CITY", help="City that only the test split has. May be repeated.")
    ] = None,
    hold_out_fleet: Annotated[
        list[int] | None,
        typer.Option(metavar="N", min=1, help="Number of aircraft that only the test split has. May be repeated."),
    ] = None,
    beside: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Result file of others to put beside these. May be repeated."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Result file. Default: scores.json in the folder of the study.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Score the detectors of a study, print a leaderboard, and write the result file.

    Options --hold-out-… replace all that the study's file holds out.
    """
    from skyrange.cli.output.score_tables import tabulate_scores
    from skyrange.scoring.result_file import ScoreSettings, read_scores, write_scores
    from skyrange.study.score_tables import score_study

    others = [read_scores(file) for file in beside or ()]
    settings = ScoreSettings(target_per_h=rate)
    scores = score_study(
        folder,
        settings,
        families=hold_out_family or (),
        cities=hold_out_city or (),
        fleet_sizes=hold_out_fleet or (),
    )
    file = out if out is not None else folder / "scores.json"
    write_scores(scores, file)
    if as_json:
        print_json(scores.model_dump(mode="json"))
        return
    for table in tabulate_scores([scores, *others]):
        terminal().print(table)
    print_text(f"scores {file}")


def _estimate(study: Study, workers: Workers, *, as_json: bool) -> None:
    from skyrange.study.design.blocks import list_blocks
    from skyrange.study.study_run import estimate_study

    estimate = estimate_study(study, list_blocks(study), workers.at_a_time())
    if as_json:
        print_json(estimate._asdict())
        return
    print_text(f"{study.name}: {estimate.points} points, {estimate.blocks} blocks, {estimate.runs} runs")
    print_text(f"simulated   {estimate.aircraft_hours:.1f} aircraft-hours")
    print_text(f"time        about {estimate.wall_s / 60.0:.1f} min with {estimate.jobs} at a time")
    print_text(f"disk        about {estimate.disk_mb:.1f} MB")
    for error in estimate.failed:
        print_notice(f"the trial failed: {error}")


def _fly(folder: StudyFolder, executor: Executor, storage: BlockStorage | None, *, as_json: bool) -> None:
    from skyrange.cli.output.progress import run_progress
    from skyrange.study.study_run import run_blocks

    with run_progress(folder.study.name, quiet=as_json) as on_progress:
        result = run_blocks(folder, executor, on_progress, storage)
    _print_result(result, as_json=as_json)


def _print_result(result: StudyResult, *, as_json: bool) -> None:
    from skyrange.cli.output.warnings import print_failed_missions
    from skyrange.study.study_run import list_failed_missions
    from skyrange.twins.failed_missions import require_baseline

    folder, missions = result.folder, list_failed_missions(result.folder)
    if as_json:
        failed = [{"block": block, "error": error} for block, error in result.failed]
        numbers = {"finished": result.finished, "flown": result.flown, "wall_s": round(result.wall_s, 3)}
        print_json(
            {
                "study": str(folder.path),
                **numbers,
                "busy_share": round(result.busy_share, 3),
                "failed": failed,
                "failed_missions": missions,
            }
        )
        require_baseline(missions, folder.path)
        return
    print_failed_missions(terminal(), missions[:_SHOWN])
    print_text(
        f"{folder.study.name}: {result.finished} of {len(folder.blocks)} blocks are finished, {result.flown} flown in "
        f"{result.wall_s:.1f} s; workers were busy for {100.0 * result.busy_share:.0f} % of the time"
    )
    if result.alone_reason and result.flown:
        print_notice(f"runs flew alone, not together in batches: {result.alone_reason}")
    _print_failures(result.failed)
    print_text(f"study   {folder.path}")
    print_text(f"results {folder.path / 'results'}")
    require_baseline(missions, folder.path)


def _print_failures(failures: Any) -> None:
    for block, error in list(failures)[:_SHOWN]:
        print_text(f"failed  {block}: {str(error).splitlines()[0]}")
    if len(failures) > _SHOWN:
        print_text(f"failed  {len(failures) - _SHOWN} more")


def _interval(interval: Interval) -> tuple[str, str]:
    limits = (
        interval.without
        if interval.low is None or interval.high is None
        else f"{interval.low:.3g} to {interval.high:.3g}"
    )
    return f"{interval.mean:.3g}", limits


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
