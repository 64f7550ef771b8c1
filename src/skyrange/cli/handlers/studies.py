"""Handlers of the commands `skyrange study`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skyrange.cli.output.console import print_json, print_notice, print_text, terminal

if TYPE_CHECKING:
    from skyrange.statistics.means import Interval
    from skyrange.study.design.model import Study
    from skyrange.study.execution.executors import Executor
    from skyrange.study.execution.storage import BlockStorage
    from skyrange.study.execution.study_run import StudyResult
    from skyrange.study.folder import StudyFolder

_SHOWN = 10
"""Failed blocks that are listed on the terminal."""


def run(
    file: Path,
    out: Path | None,
    changes: Sequence[str],
    jobs: int | None,
    on: str | None,
    storage: str | None,
    dry_run: bool,
    as_json: bool,
) -> None:
    """`skyrange study run`."""
    from skyrange.cli.output.progress import compile_if_cold, map_progress
    from skyrange.study.design.model import read_study
    from skyrange.study.execution.study_run import run_study

    study = read_study(file, changes)
    compile_if_cold(quiet=as_json)
    if dry_run:
        _estimate(study, jobs, as_json)
        return
    place, executor = _storage(storage, on), _executor(jobs, on)
    with map_progress(study.name, "blocks", quiet=as_json) as on_block:
        result = run_study(study, out, executor=executor, on_block=on_block, storage=place)
    _print_result(result, as_json)


def register(file: Path, out: Path | None, changes: Sequence[str], as_json: bool) -> None:
    """`skyrange study register`."""
    from skyrange.study.design.model import read_study
    from skyrange.study.registration import register_study

    folder, registered = register_study(read_study(file, changes), out)
    if as_json:
        print_json({"folder": str(folder.path), **registered._asdict()})
        return
    print_text(f"registered {folder.study.name} on {registered.registered_utc}: {folder.path / 'registration.json'}")
    print_text(f"to publish, SHA-256: {registered.hash}")
    print_text(f"to fly it: skyrange study run {file} --out {folder.path}")


def resume(
    path: Path, jobs: int | None, on: str | None, storage: str | None, other_version: bool, retry: bool, as_json: bool
) -> None:
    """`skyrange study resume`."""
    from skyrange.study.execution.study_run import forget_failures
    from skyrange.study.folder import open_folder, require_unchanged

    folder = open_folder(path)
    require_unchanged(folder, other_version=other_version)
    place = _storage(storage, on)
    if retry:
        forget_failures(folder, place)
    _fly(folder, _executor(jobs, on), place, as_json)


def status(path: Path, as_json: bool) -> None:
    """`skyrange study status`."""
    from skyrange.study.execution.study_run import list_failures
    from skyrange.study.folder import open_folder

    folder = open_folder(path)
    finished, failures = len(folder.finished()), list_failures(folder)
    if as_json:
        data: dict[str, Any] = {"study": folder.study.name, "blocks": len(folder.blocks), "finished": finished}
        print_json({**data, "failed": [{"block": block, "error": error} for block, error in failures]})
        return
    arms = len(folder.study.arms)
    print_text(f"{folder.study.name}: {finished} of {len(folder.blocks)} blocks of {arms} runs are finished")
    _print_failures(failures)
    if finished < len(folder.blocks):
        print_text(f"to go on: skyrange study resume {folder.path}")


def show(path: Path, as_json: bool) -> None:
    """`skyrange study show`."""
    from rich.table import Table

    from skyrange.study.folder import open_folder
    from skyrange.study.registration import QUANTITIES
    from skyrange.study.results import write_results
    from skyrange.study.summary import read_samples, summarise_study, tells_something

    folder = open_folder(path)
    write_results(folder)
    cells = summarise_study(folder)
    if as_json:
        rows = [
            {**cell._asdict(), "means": {name: mean._asdict() for name, mean in cell.means.items()}} for cell in cells
        ]
        print_json({"study": folder.study.name, "cells": rows})
        return
    samples = read_samples(path)
    shown = [one for one in QUANTITIES if tells_something(one, samples)]
    table = Table(title=folder.study.name, title_justify="left", title_style="bold")
    names = [factor.name for factor in folder.study.factors]
    for name in (*names, "arm", "runs", "measure", "mean", "95 % interval"):
        table.add_column(name)
    for cell in cells:
        runs = str(cell.runs) if not cell.failed else f"{cell.runs}, {cell.failed} failed"
        head = [*map(_short, cell.values.values()), cell.arm, runs]
        for one in shown:
            if one.name in cell.means:
                what = f"{one.name}" if not one.unit else f"{one.name.removesuffix(f'_{one.unit}')}, {one.unit}"
                table.add_row(*head, what, *_interval(cell.means[one.name]))
                head = [""] * len(head)
    terminal().print(table)


def report(path: Path, pdf: bool) -> None:
    """`skyrange study report`."""
    from skyrange.study.page import write_study_report

    print_text(f"report {write_study_report(path, pdf=pdf)}")


def score(
    path: Path,
    rate: float,
    families: Sequence[str],
    cities: Sequence[str],
    fleets: Sequence[int],
    beside: Sequence[Path],
    out: Path | None,
    as_json: bool,
) -> None:
    """`skyrange study score`."""
    from skyrange.cli.output.score_tables import tabulate_scores
    from skyrange.scoring.result_file import ScoreSettings, read_scores, write_scores
    from skyrange.study.score_tables import score_study

    others = [read_scores(file) for file in beside]
    settings = ScoreSettings(target_per_h=rate)
    scores = score_study(path, settings, families=families, cities=cities, fleet_sizes=fleets)
    file = out if out is not None else path / "scores.json"
    write_scores(scores, file)
    if as_json:
        print_json(scores.model_dump(mode="json"))
        return
    for table in tabulate_scores([scores, *others]):
        terminal().print(table)
    print_text(f"scores {file}")


def _estimate(study: Study, jobs: int | None, as_json: bool) -> None:
    from skyrange.study.design.blocks import list_blocks
    from skyrange.study.execution.study_run import estimate_study

    found = estimate_study(study, list_blocks(study), _jobs(jobs))
    if as_json:
        print_json(found._asdict())
        return
    print_text(f"{study.name}: {found.points} points, {found.blocks} blocks, {found.runs} runs")
    print_text(f"simulated   {found.aircraft_hours:.1f} aircraft-hours")
    print_text(f"time        about {found.wall_s / 60.0:.1f} min with {found.jobs} at a time")
    print_text(f"disk        about {found.disk_mb:.1f} MB")
    for error in found.failed:
        print_notice(f"the trial failed: {error}")


def _fly(folder: StudyFolder, executor: Executor, storage: BlockStorage | None, as_json: bool) -> None:
    from skyrange.cli.output.progress import map_progress
    from skyrange.study.execution.study_run import run_blocks

    with map_progress(folder.study.name, "blocks", quiet=as_json) as on_block:
        result = run_blocks(folder, executor, on_block, storage)
    _print_result(result, as_json)


def _print_result(result: StudyResult, as_json: bool) -> None:
    from skyrange.cli.output.warnings import print_failed_missions
    from skyrange.study.execution.study_run import list_failed_missions
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
    _print_failures(result.failed)
    print_text(f"study   {folder.path}")
    print_text(f"results {folder.path / 'results'}")
    require_baseline(missions, folder.path)


def _print_failures(failures: Any) -> None:
    for block, error in list(failures)[:_SHOWN]:
        print_text(f"failed  {block}: {str(error).splitlines()[0]}")
    if len(failures) > _SHOWN:
        print_text(f"failed  {len(failures) - _SHOWN} more")


def _executor(jobs: int | None, on: str | None) -> Executor:
    from skyrange.core.errors import InputError
    from skyrange.study.execution.executors import LocalPool, RayPool

    if on is None:
        return LocalPool(_jobs(jobs))
    if jobs is not None:
        raise InputError.one("study", "--jobs", str(jobs), "none with --on: the cluster says how many")
    return RayPool(on)


def _storage(url: str | None, on: str | None) -> BlockStorage | None:
    from skyrange.core.errors import InputError
    from skyrange.study.execution.storage import BlockStorage

    if url is None:
        return None
    if on is None:
        raise InputError.one("study", "--storage", url, "none without --on: this machine writes to the study's folder")
    return BlockStorage(url)


def _jobs(jobs: int | None) -> int:
    return jobs if jobs is not None else len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1


def _interval(found: Interval) -> tuple[str, str]:
    limits = found.without if found.low is None or found.high is None else f"{found.low:.3g} to {found.high:.3g}"
    return f"{found.mean:.3g}", limits


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
