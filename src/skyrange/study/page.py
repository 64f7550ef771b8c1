"""Page of a study as one HTML file, with its figures (dose-response curves, interactions) as SVG files beside it."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from skyrange.core.files import atomic_write
from skyrange.figures import svg
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure, load_converter, save_pdf
from skyrange.report.rendering import asset, content_policy, render, table_script
from skyrange.statistics.means import BOOTSTRAP_FROM, SKEWED, Interval, estimate_mean, standardised_effect
from skyrange.study.design.blocks import is_numeric
from skyrange.study.folder import StudyFolder, open_folder
from skyrange.study.registration import MISSIONS, QUANTITIES, Quantity, Registered, read_registration
from skyrange.study.results import cluster_samples, read_results, write_results
from skyrange.study.study_run import list_failed_missions, list_failures
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
Link = Callable[[Level], str]

_WIDE: Final = 640.0
_HIGH: Final = 320.0
_LEFT: Final = 70.0
_RIGHT: Final = 150.0
_TOP: Final = 18.0
_FOOT: Final = 56.0


def draw_curves(
    title: str,
    across: str,
    upwards: str,
    levels: Sequence[Level],
    curves: Sequence[Curve],
    *,
    numeric: bool,
    link: Link | None = None,
) -> Figure:
    """Curves over the levels of a factor, with the 95 % interval of each mean. The axis of a `numeric` factor has ticks
    at round numbers, that of another the names of its levels. With `link`, the mark of a level leads to an address.
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
            hrefs = {level.at: link(level) for level in levels} if link is not None else {}
            body += _draw_curve(curve, 5.0 * (number - 0.5 * (len(curves) - 1)), x_of, y_of, hrefs)
        y = _TOP + 14 + 20 * number
        key: svg.Attributes = {"x": _WIDE - _RIGHT + 14, "y": y - 9, "width": 12, "height": 12, "fill": _ink(curve)}
        body.append(svg.element("rect", key))
        body.append(svg.label(_WIDE - _RIGHT + 32, y + 1, curve.name, "start", 12))
    return svg.document(_WIDE, _HIGH, title, body, role="img" if link is None else "group")


def _draw_curve(curve: Curve, aside: float, x_of: Scale, y_of: Scale, hrefs: Mapping[float, str]) -> Iterator[Element]:
    """A line through the means, and a bar for each interval, `aside` so that bars of two curves do not overlap.

    `hrefs` are the addresses to which the marks lead, by their place on the axis.
    """
    ink = {"stroke": _ink(curve), "fill": "none", "stroke-width": "2"}
    points = np.array([(x_of(at) + aside, y_of(mean.mean)) for at, mean in curve.points])
    yield svg.element("path", {"d": svg.path_data(points), **ink})
    for (x, y), (at, mean) in zip(points.tolist(), curve.points, strict=True):
        title = f"{curve.name}: {mean.mean:.4g}, {mean.n} blocks"
        if mean.low is not None and mean.high is not None:
            bar = f"M{svg.format_number(x)} {svg.format_number(y_of(mean.low))}V{svg.format_number(y_of(mean.high))}"
            yield svg.element("path", {"d": bar, **ink, "stroke-opacity": ".6"})
            title = f"{curve.name}: {mean.mean:.4g} ({mean.low:.4g} to {mean.high:.4g}), {mean.n} blocks"
        mark = svg.element("circle", {"cx": x, "cy": y, "r": 4, "fill": _ink(curve)}, svg.title(title))
        yield svg.element("a", {"href": hrefs[at], "aria-label": title}, mark) if at in hrefs else mark


def _ink(curve: Curve) -> str:
    return OKABE_ITO[curve.colour % len(OKABE_ITO)]


REPORT: Final = "report.html"
FIGURES: Final = "figures"
_MAX_LINES: Final = 4
"""Levels of the second factor that are drawn in the figure of an interaction."""


class Drawing(NamedTuple):
    """A figure of the report, as it is in its file, and as it is in the page, where marks lead to points."""

    title: str
    file: str
    figure: Figure
    linked: Figure


def write_study_report(path: Path | str, *, pdf: bool = False) -> Path:
    """Write `report.html` and `figures/*.svg` into a study's folder, from the finished blocks; returns the report.

    With `pdf`, the figures are there as PDF as well. Raises `InputError` if that needs a package that is not installed.
    """
    if pdf:
        load_converter()  # before anything is written
    folder = open_folder(Path(path))
    write_results(folder)
    study, samples = folder.study, read_samples(folder.path)
    runs = read_results(folder.path, "runs").to_pylist()
    clusters = cluster_samples(folder, runs)
    registered = read_registration(folder)
    registered_measures = registered.measures if registered is not None else ()
    shown = [
        quantity
        for quantity in QUANTITIES
        if quantity.name in registered_measures or tells_something(quantity, samples)
    ]
    effects = list(_compare_arms(folder, samples, clusters, shown))
    differences = draw_differences(effects, study.against)
    drawings = [
        *_draw_responses(folder, samples, clusters, shown),
        *_draw_interactions(folder, samples, clusters, shown),
    ]
    (folder.path / FIGURES).mkdir(exist_ok=True)
    files = {drawing.file: drawing.figure for drawing in drawings}
    if differences is not None:
        files["differences.svg"] = differences
    for name, figure in files.items():
        target = figure.save(folder.path / FIGURES / name)
        if pdf:
            save_pdf(figure, target.with_suffix(".pdf"))
    style, script = asset("style.css"), table_script()
    done, missions = _count_missions(runs)
    page = render(
        "study/page.html.jinja",
        policy=content_policy(style, script),
        script=script,
        title=f"{study.name} · study · skyrange",
        style=style,
        name=study.name,
        verdict=describe_effects(effects, study.against),
        missions=f"{done} of {missions} missions complete" if missions else "",
        pill="ok" if done == missions else "wait",
        differences=differences,
        failed=list_failed_missions(folder),
        scenario=Path(study.scenario).name,
        baseline=study.against,
        blocks=len(folder.blocks),
        finished=len(folder.finished()),
        independent=len({clusters[block.name] for block in folder.finished()}),
        arms=[arm.id for arm in study.arms],
        tables=[
            _tabulate_design(folder),
            _tabulate_effects(folder, effects, registered),
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


def _count_missions(runs: Sequence[Mapping[str, Any]]) -> tuple[int, int]:
    """How many missions of all runs are complete, and of how many."""
    known = [row for row in runs if row.get(MISSIONS) is not None]
    return sum(int(row[MISSIONS]) for row in known), sum(int(row["vehicles"] or 0) for row in known)


def _tabulate_effects(folder: StudyFolder, effects: Sequence[Effect], registered: Registered | None) -> Table:
    """Each arm against the baseline, over all blocks: the mean of the paired differences."""
    rows, notes = [], []
    for effect in effects:
        quantity, differences, mean = effect.quantity, effect.differences, effect.mean
        size = standardised_effect(differences, effect.clusters)
        counts = [str(len(differences)), str(mean.n if mean else 0)]
        kind = "registered" if registered is not None and quantity.name in registered.measures else "exploratory"
        shares = format_interval(mean), "–" if size is None else f"{size:.2f}"
        rows.append([_heading(quantity), effect.arm, kind, *counts, *shares])
        notes.append(quantity.about)
    head = ["measure", "arm", "", "blocks", "independent", "mean difference (95 % interval)", "over its deviation"]
    return Table(f"Effects against {folder.study.against}", head, rows, notes)


class Effect(NamedTuple):
    """The paired differences of an arm and the baseline in one quantity, over all blocks that have both."""

    quantity: Quantity
    arm: str
    differences: Sequence[float]
    clusters: Sequence[str]
    mean: Interval | None


def _compare_arms(
    folder: StudyFolder, samples: Samples, clusters: Mapping[str, str], shown: Sequence[Quantity]
) -> Iterator[Effect]:
    for quantity in shown:
        base = samples.get((quantity.name, folder.study.against), {})
        for arm in folder.study.arms:
            if arm.id == folder.study.against:
                continue
            arm_samples = samples.get((quantity.name, arm.id), {})
            pairs = sorted(set(arm_samples) & set(base)) if quantity.table == "runs" else sorted(arm_samples)
            differences = [arm_samples[name] - base.get(name, 0.0) for name in pairs]
            own_clusters = [clusters[name] for name in pairs]
            yield Effect(quantity, arm.id, differences, own_clusters, estimate_mean(differences, own_clusters))


def draw_differences(effects: Sequence[Effect], against: str) -> Figure | None:
    """A row for each measure and arm: the paired differences of all blocks, their mean and its 95 % interval.

    Each row has a scale of its own, from 0 in the same place; `None` without differences.
    """
    shown = [effect for effect in effects if len(effect.differences)]
    if not shown:
        return None
    left, wide, high, top = 250.0, 760.0, 34.0, 26.0
    body = [svg.element("path", {"d": f"M{left + wide / 2:.1f} {top - 6:.1f}v{high * len(shown) + 6:.1f}", **svg.GRID})]
    body.append(svg.label(left + wide / 2, top - 11, f"as {against}", extra={"opacity": ".75"}))
    for number, effect in enumerate(shown):
        y, ink = top + high * (number + 0.5), OKABE_ITO[(number + 1) % len(OKABE_ITO)]
        ends = (
            [*effect.differences, *(end for end in (effect.mean.low, effect.mean.high) if end is not None)]
            if (effect.mean is not None)
            else list(effect.differences)
        )
        most = max((abs(value) for value in ends), default=0.0) or 1.0

        def x_of(value: float, most: float = most) -> float:
            return left + wide / 2 * (1.0 + 0.96 * value / most)

        body.append(svg.label(left - 14, y + 4, f"{_heading(effect.quantity)}, {effect.arm}", "end"))
        for value in effect.differences:
            dot: svg.Attributes = {"cx": x_of(value), "cy": y, "r": 3, "fill": ink, "fill-opacity": ".35"}
            body.append(svg.element("circle", dot, svg.title(f"{value:.4g}")))
        mean = effect.mean
        if mean is None:
            continue
        if mean.low is not None and mean.high is not None:
            bar = f"M{x_of(mean.low):.1f} {y:.1f}H{x_of(mean.high):.1f}"
            body.append(svg.element("path", {"d": bar, "stroke": ink, "stroke-width": "3"}))
        diamond = f"M{x_of(mean.mean):.1f} {y - 7:.1f}l6 7l-6 7l-6 -7z"
        body.append(svg.element("path", {"d": diamond, "fill": ink}, svg.title(f"mean {mean.mean:.4g}")))
        body.append(svg.label(left + wide + 14, y + 4, format_interval(mean), "start", extra=_bold(mean)))
    foot = top + high * len(shown) + 18
    body.append(
        svg.label(
            left,
            foot,
            "dots: blocks; diamond and bar: mean, 95 % interval; bold: it excludes 0; each row has its own scale",
            "start",
            10.5,
            {"opacity": ".75"},
        )
    )
    return svg.document(left + wide + 190, foot + 10, f"Paired differences from {against}", body)


def _bold(mean: Interval) -> svg.Attributes | None:
    return svg.BOLD if mean.excludes_zero else None


def describe_effects(effects: Sequence[Effect], against: str) -> str:
    """The study in a sentence: the differences whose interval excludes 0, those whose does not, and what is unknown."""
    clear = [effect for effect in effects if effect.mean is not None and effect.mean.excludes_zero]
    if not any(effect.differences for effect in effects):
        return "No block has flown that compares arms."
    if not clear:
        return f"No measure of any arm differs from {against} by more than its 95 % interval."
    shown = "; ".join(
        f"{effect.arm} {_heading(effect.quantity)} {effect.mean.mean:+.3g}"
        for effect in clear
        if effect.mean is not None
    )
    return f"Against {against}, by more than the 95 % interval: {shown.replace('-', '−')}."


def _tabulate_cells(folder: StudyFolder, shown: Sequence[Quantity]) -> Table:
    names = [factor.name for factor in folder.study.factors]
    rows, commands, anchors = [], [], []
    for cell in summarise_study(folder):
        runs = str(cell.runs) if not cell.failed else f"{cell.runs}, {cell.failed} failed"
        means = [format_interval(cell.means.get(quantity.name)) for quantity in shown]
        rows.append([*(_short(cell.values[name]) for name in names), cell.arm, runs, *means])
        first = next(block for block in folder.blocks if block.point == cell.point)
        command = f"skyrange watch {shlex.quote(str(folder.path))} --run {first.name}"
        commands.append("" if command in commands else command)
        anchor = _anchor(cell.point)
        anchors.append("" if anchor in anchors else anchor)
    head = [*names, "arm", "runs", *map(_heading, shown)]
    return Table("Points", head, rows, [""] * len(rows), commands, anchors)


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
        for quantity in shown:
            arms = [arm.id for arm in folder.study.arms if samples.get((quantity.name, arm.id))]
            curves = [trace_response(arm, colours[arm], levels, samples[quantity.name, arm], clusters) for arm in arms]
            title = f"{_heading(quantity)} by {factor.name}"
            figure, linked = (
                draw_curves(title, factor.name, _heading(quantity), levels, curves, numeric=numeric, link=link)
                for link in (None, _link_point(folder))
            )
            yield Drawing(title, f"{quantity.name}-by-{factor.name}.svg", figure, linked)


def _draw_interactions(
    folder: StudyFolder, samples: Samples, clusters: Mapping[str, str], shown: Sequence[Quantity]
) -> Iterator[Drawing]:
    """For each two factors, the first measure of the last arm: a curve for each level of the second."""
    factors = folder.study.factors
    for place, first in enumerate(factors):
        for second in factors[place + 1 :]:
            levels, lines = find_levels(folder.blocks, first.name), find_levels(folder.blocks, second.name, _MAX_LINES)
            arm = folder.study.arms[-1].id
            chosen = next((quantity for quantity in shown if samples.get((quantity.name, arm))), None)
            if chosen is None or len(levels) < 2 or len(lines) < 2:
                continue
            arm_samples = samples[chosen.name, arm]
            curves = [
                trace_response(
                    f"{second.name} {line.label}", number, levels, arm_samples, clusters, frozenset(line.blocks)
                )
                for number, line in enumerate(lines[:_MAX_LINES])
            ]
            title = f"{_heading(chosen)}, {arm}: {first.name} and {second.name}"
            numeric = is_numeric(folder.blocks, first.name)
            figure, linked = (
                draw_curves(title, first.name, _heading(chosen), levels, curves, numeric=numeric, link=link)
                for link in (None, _link_point(folder))
            )
            yield Drawing(title, f"{chosen.name}-by-{first.name}-and-{second.name}.svg", figure, linked)


def _link_point(folder: StudyFolder) -> Link:
    """The row of the first point that has one of a level's blocks."""
    points = {block.name: block.point for block in folder.blocks}
    return lambda level: f"#{_anchor(points[level.blocks[0]])}"


def _anchor(point: int) -> str:
    return f"point-{point}"


def _heading(quantity: Quantity) -> str:
    name = quantity.name.removesuffix(f"_{quantity.unit}") if quantity.unit else quantity.name
    return f"{name.replace('_', ' ')} ({quantity.unit})" if quantity.unit else name.replace("_", " ")


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
