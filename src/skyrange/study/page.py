"""Page of a study as one HTML file, with its figures (dose-response curves, interactions) as SVG files beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from skyrange.core.files import atomic_write
from skyrange.figures import svg
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure, load_converter, save_pdf
from skyrange.report.rendering import asset, content_policy, render
from skyrange.statistics.means import BOOTSTRAP_FROM, SKEWED, estimate_mean, standardised_effect
from skyrange.study.design.blocks import is_numeric
from skyrange.study.execution.study_run import list_failed_missions, list_failures
from skyrange.study.folder import StudyFolder, open_folder
from skyrange.study.registration import QUANTITIES, Quantity, Registered, read_registration
from skyrange.study.results import cluster_samples, read_results, write_results
from skyrange.study.summary import (
    Curve,
    Level,
    Samples,
    find_levels,
    read_samples,
    summarise_study,
    tells_something,
    trace_response,
)
from skyrange.study.variants import Table, format_interval

Scale = Callable[[float], float]

_WIDE: Final = 640.0
_HIGH: Final = 320.0
_LEFT: Final = 70.0
_RIGHT: Final = 150.0
_TOP: Final = 18.0
_FOOT: Final = 56.0


def draw_curves(
    title: str, across: str, upwards: str, levels: Sequence[Level], curves: Sequence[Curve], *, numeric: bool
) -> Figure:
    """Curves over the levels of a factor, with the 95 % interval of each mean. The axis of a `numeric` factor has ticks
    at round numbers, that of another the names of its levels.
    """
    drawn = [mean for curve in curves for _, mean in curve.points]
    low = min([0.0, *(mean.mean if mean.low is None else mean.low for mean in drawn)])
    high = max([0.0, *(mean.mean if mean.high is None else mean.high for mean in drawn)])
    high = high if high > low else low + 1.0
    first, last = levels[0].at, levels[-1].at
    span = (last - first) or 1.0

    def x_of(at: float) -> float:
        return _LEFT + 20.0 + (at - first) / span * (_WIDE - _LEFT - _RIGHT - 40.0)

    def y_of(value: float) -> float:
        return _HIGH - _FOOT - (value - low) / (high - low) * (_HIGH - _TOP - _FOOT)

    values, step = svg.ticks(low, high)
    body = []
    for value in values:
        line = f"M{_LEFT} {svg.format_number(y_of(value))}H{_WIDE - _RIGHT}"
        body.append(svg.element("path", {"d": line, **svg.GRID}))
        body.append(svg.label(_LEFT - 8, y_of(value) + 4, svg.format_tick(value, step), "end"))
    named = [(level.at, level.label) for level in levels]
    if numeric and span > 0.0 and len(levels) > 1:
        round_values, distance = svg.ticks(first, last)
        named = [(value, svg.format_tick(value, distance)) for value in round_values]
    body += [svg.label(x_of(at), _HIGH - _FOOT + 18, name) for at, name in named]
    body.append(svg.label(_WIDE - _RIGHT, _HIGH - 12, across, "end", 12))
    body.append(svg.label(4, _TOP - 6, upwards, "start", 12))
    for number, curve in enumerate(curves):
        if curve.points:
            body += _draw_curve(curve, 5.0 * (number - 0.5 * (len(curves) - 1)), x_of, y_of)
        y = _TOP + 14 + 20 * number
        key: svg.Attributes = {"x": _WIDE - _RIGHT + 14, "y": y - 9, "width": 12, "height": 12, "fill": _ink(curve)}
        body.append(svg.element("rect", key))
        body.append(svg.label(_WIDE - _RIGHT + 32, y + 1, curve.name, "start", 12))
    return svg.document(_WIDE, _HIGH, title, body)


def _draw_curve(curve: Curve, aside: float, x_of: Scale, y_of: Scale) -> Iterator[Element]:
    """A line through the means, and a bar for each interval, `aside` so that bars of two curves do not overlap."""
    ink = {"stroke": _ink(curve), "fill": "none", "stroke-width": "2"}
    points = np.array([(x_of(at) + aside, y_of(mean.mean)) for at, mean in curve.points])
    yield svg.element("path", {"d": svg.path_data(points), **ink})
    for (x, y), (_, mean) in zip(points.tolist(), curve.points, strict=True):
        said = f"{curve.name}: {mean.mean:.4g}, {mean.n} blocks"
        if mean.low is not None and mean.high is not None:
            bar = f"M{svg.format_number(x)} {svg.format_number(y_of(mean.low))}V{svg.format_number(y_of(mean.high))}"
            yield svg.element("path", {"d": bar, **ink, "stroke-opacity": ".6"})
            said = f"{curve.name}: {mean.mean:.4g} ({mean.low:.4g} to {mean.high:.4g}), {mean.n} blocks"
        yield svg.element("circle", {"cx": x, "cy": y, "r": 3.5, "fill": _ink(curve)}, svg.title(said))


def _ink(curve: Curve) -> str:
    return OKABE_ITO[curve.colour % len(OKABE_ITO)]


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
