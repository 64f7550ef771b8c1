"""Report of a study as one HTML file, with its figures as SVG files beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from skyrange.core.files import atomic_write
from skyrange.figures.pdf import load_converter, save_pdf
from skyrange.figures.svg import Figure
from skyrange.report.rendering import asset, content_policy, render
from skyrange.statistics.means import BOOTSTRAP_FROM, SKEWED, estimate_mean, standardised_effect
from skyrange.study.sweep.design.blocks import is_numeric
from skyrange.study.sweep.execution.study_run import list_failed_missions, list_failures
from skyrange.study.sweep.folder import StudyFolder, open_folder
from skyrange.study.sweep.independence import cluster_samples
from skyrange.study.sweep.quantities import QUANTITIES, Quantity
from skyrange.study.sweep.registration import Registered, read_registration
from skyrange.study.sweep.report.figure import draw_curves
from skyrange.study.sweep.report.response import find_levels, trace_response
from skyrange.study.sweep.report.summary import Samples, read_samples, summarise_study, tells_something
from skyrange.study.sweep.results import read_results, write_results
from skyrange.study.variants.sections import Table, format_interval

REPORT: Final = "report.html"
FIGURES: Final = "figures"
_MAX_LINES: Final = 4
"""Levels of the second factor that are drawn in the figure of an interaction."""


class Drawing(NamedTuple):
    """A figure of the report."""

    title: str
    file: str
    figure: Figure


def write_study_report(path: Path | str, *, pdf: bool = False) -> Path:
    """Write `report.html` and `figures/*.svg` into a study's folder, from the finished blocks; returns the report.

    With `pdf`, the figures are there as PDF as well. Raises `InputError` if that needs a package that is not installed.
    """
    if pdf:
        load_converter()  # before anything is written
    folder = open_folder(Path(path))
    write_results(folder)
    study, samples = folder.study, read_samples(folder.path)
    clusters = cluster_samples(folder, read_results(folder.path, "runs").to_pylist())
    registered = read_registration(folder)
    asked = registered.measures if registered is not None else ()
    shown = [one for one in QUANTITIES if one.name in asked or tells_something(one, samples)]
    drawings = [
        *_draw_responses(folder, samples, clusters, shown),
        *_draw_interactions(folder, samples, clusters, shown),
    ]
    (folder.path / FIGURES).mkdir(exist_ok=True)
    for drawing in drawings:
        target = drawing.figure.save(folder.path / FIGURES / drawing.file)
        if pdf:
            save_pdf(drawing.figure, target.with_suffix(".pdf"))
    style = asset("style.css")
    page = render(
        "study/page.html.jinja",
        policy=content_policy(style),
        title=f"{study.name} · study · skyrange",
        style=style,
        name=study.name,
        failed=list_failed_missions(folder),
        scenario=Path(study.scenario).name,
        baseline=study.against,
        blocks=len(folder.blocks),
        finished=len(folder.finished()),
        independent=len({clusters[block.name] for block in folder.finished()}),
        arms=[arm.id for arm in study.arms],
        tables=[
            _tabulate_design(folder),
            _tabulate_effects(folder, samples, clusters, shown, registered),
            _tabulate_cells(folder, shown),
        ],
        drawings=drawings,
        failures=list_failures(folder),
        registered=registered,
        bootstrap_from=BOOTSTRAP_FROM,
        skewed=SKEWED,
    )
    with atomic_write(folder.path / REPORT) as file:
        file.write(str(page).encode())
    return folder.path / REPORT


def _tabulate_design(folder: StudyFolder) -> Table:
    rows, notes = [], []
    for kind, factors in (("factor", folder.study.factors), ("draw", folder.study.draws)):
        for factor in factors:
            values = ", ".join(map(str, factor.levels)) if factor.levels else f"{factor.low:g} to {factor.high:g}"
            rows.append([factor.name, kind, factor.key, values])
            notes.append("")
    return Table("Design", ["name", "", "key", "values"], rows, notes)


def _tabulate_effects(
    folder: StudyFolder,
    samples: Samples,
    clusters: Mapping[str, str],
    shown: Sequence[Quantity],
    registered: Registered | None,
) -> Table:
    """Each arm against the baseline, over all blocks: the mean of the paired differences."""
    rows, notes = [], []
    for one in shown:
        base = samples.get((one.name, folder.study.against), {})
        for arm in folder.study.arms:
            if arm.id == folder.study.against:
                continue
            own = samples.get((one.name, arm.id), {})
            pairs = sorted(set(own) & set(base)) if one.table == "runs" else sorted(own)
            differences = [own[name] - base.get(name, 0.0) for name in pairs]
            own_clusters = [clusters[name] for name in pairs]
            mean, size = (
                estimate_mean(differences, own_clusters),
                standardised_effect(differences, own_clusters),
            )
            counts = [str(len(pairs)), str(mean.n if mean else 0)]
            kind = "registered" if registered is not None and one.name in registered.measures else "exploratory"
            shares = format_interval(mean), "–" if size is None else f"{size:.2f}"
            rows.append([_heading(one), arm.id, kind, *counts, *shares])
            notes.append(one.about)
    head = ["measure", "arm", "", "blocks", "independent", "mean difference (95 % interval)", "over its deviation"]
    return Table(f"Effects against {folder.study.against}", head, rows, notes)


def _tabulate_cells(folder: StudyFolder, shown: Sequence[Quantity]) -> Table:
    names = [factor.name for factor in folder.study.factors]
    rows = []
    for cell in summarise_study(folder):
        runs = str(cell.runs) if not cell.failed else f"{cell.runs}, {cell.failed} failed"
        means = [format_interval(cell.means.get(one.name)) for one in shown]
        rows.append([*(_short(cell.values[name]) for name in names), cell.arm, runs, *means])
    return Table("Points", [*names, "arm", "runs", *map(_heading, shown)], rows, [""] * len(rows))


def _draw_responses(
    folder: StudyFolder, samples: Samples, clusters: Mapping[str, str], shown: Sequence[Quantity]
) -> Iterator[Drawing]:
    """A dose-response curve for each factor and draw, and each measure."""
    colours = {arm.id: number for number, arm in enumerate(folder.study.arms)}
    for factor in (*folder.study.factors, *folder.study.draws):
        levels = find_levels(folder.blocks, factor.name)
        numeric = is_numeric(folder.blocks, factor.name)
        if len(levels) < 2:
            continue
        for one in shown:
            arms = [arm.id for arm in folder.study.arms if samples.get((one.name, arm.id))]
            curves = [trace_response(arm, colours[arm], levels, samples[one.name, arm], clusters) for arm in arms]
            title = f"{_heading(one)} by {factor.name}"
            figure = draw_curves(title, factor.name, _heading(one), levels, curves, numeric=numeric)
            yield Drawing(title, f"{one.name}-by-{factor.name}.svg", figure)


def _draw_interactions(
    folder: StudyFolder, samples: Samples, clusters: Mapping[str, str], shown: Sequence[Quantity]
) -> Iterator[Drawing]:
    """For each two factors, the first measure of the last arm: a curve for each level of the second."""
    factors = folder.study.factors
    for place, first in enumerate(factors):
        for second in factors[place + 1 :]:
            levels, lines = find_levels(folder.blocks, first.name), find_levels(folder.blocks, second.name, _MAX_LINES)
            arm = folder.study.arms[-1].id
            chosen = next((one for one in shown if samples.get((one.name, arm))), None)
            if chosen is None or len(levels) < 2 or len(lines) < 2:
                continue
            own = samples[chosen.name, arm]
            curves = [
                trace_response(f"{second.name} {line.label}", number, levels, own, clusters, frozenset(line.blocks))
                for number, line in enumerate(lines[:_MAX_LINES])
            ]
            title = f"{_heading(chosen)}, {arm}: {first.name} and {second.name}"
            numeric = is_numeric(folder.blocks, first.name)
            figure = draw_curves(title, first.name, _heading(chosen), levels, curves, numeric=numeric)
            yield Drawing(title, f"{chosen.name}-by-{first.name}-and-{second.name}.svg", figure)


def _heading(one: Quantity) -> str:
    name = one.name.removesuffix(f"_{one.unit}") if one.unit else one.name
    return f"{name.replace('_', ' ')} ({one.unit})" if one.unit else name.replace("_", " ")


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
