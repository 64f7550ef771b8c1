"""Figures of the agreement of radio engines: shares of decoded frames against each other, and residuals of losses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from skyrange.figures import svg
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure
from tools.agreement.radio.agreement import PARTIAL, WITHIN, Comparison
from tools.agreement.radio.own_losses import Residual

_SIZE: Final = 260.0
_LEFT, _TOP, _GAP = 44.0, 40.0, 36.0
_BEYOND_DB: Final = 60.0


def draw_shares(comparison: Comparison, first: str, others: Mapping[str, Sequence[tuple[float, float]]]) -> Figure:
    """Draw a panel for each of `others`, by title: the share decoded in each cell over that of `first`.

    Each has a pair for each cell, the share of `first` and its own.

    The band is the agreement that is asked for. Colours are experiments; cells that do not count are faint.
    """
    width = _LEFT + len(others) * (_SIZE + _GAP)
    height = _TOP + _SIZE + 62.0
    colours = dict(zip(comparison.experiments, OKABE_ITO, strict=False))
    body: list[Element] = []
    for panel, (other, pairs) in enumerate(others.items()):
        x0 = _LEFT + panel * (_SIZE + _GAP)
        body += _axes(x0, first, other)
        for row, (experiment, facts) in enumerate(comparison.cells):
            mine, theirs = pairs[row]
            if not np.isfinite(mine) or not np.isfinite(theirs):
                continue
            counts = any(PARTIAL[0] <= share <= PARTIAL[1] for share in (mine, theirs))
            dot: svg.Attributes = {
                "cx": x0 + mine * _SIZE, "cy": _TOP + (1.0 - theirs) * _SIZE, "r": 2.6,
                "fill": colours[experiment], "fill-opacity": ".8" if counts else ".15",
            }  # fmt: skip
            said = f"{experiment}: {_describe(facts)}: {mine:.3f}, {theirs:.3f}"
            body.append(svg.element("circle", dot, svg.title(said)))
    x = _LEFT
    for experiment, colour in colours.items():
        body.append(svg.element("circle", {"cx": x + 4, "cy": height - 10, "r": 4, "fill": colour}))
        body.append(svg.label(x + 13, height - 6, experiment, "start"))
        x += 30 + 7 * len(experiment)
    return svg.document(width, height, f"Share of decoded frames: {first} and {', '.join(others)}", body)


def _axes(x0: float, first: str, other: str) -> list[Element]:
    """Axes from 0 to 1 with the diagonal and the band of agreement."""
    outline = ((0.0, 0.0), (0.0, WITHIN), (1.0 - WITHIN, 1.0), (1.0, 1.0), (1.0, 1.0 - WITHIN), (WITHIN, 0.0))
    points = np.array([(x0 + x * _SIZE, _TOP + (1.0 - y) * _SIZE) for x, y in outline])
    body = [
        svg.label(x0, _TOP - 22, other, "start", 12, svg.BOLD),
        svg.element("path", {"d": svg.path_data(points, close=True), "fill": "currentColor", "fill-opacity": ".08"}),
    ]
    for tick in (0.0, 0.25, 0.5, 0.75, 1.0):
        x, y = x0 + tick * _SIZE, _TOP + (1.0 - tick) * _SIZE
        lines = (f"M{x:.1f} {_TOP:.1f}v{_SIZE:.1f}", f"M{x0:.1f} {y:.1f}h{_SIZE:.1f}")
        body += [svg.element("path", {"d": data, **svg.GRID}) for data in lines]
        body.append(svg.label(x, _TOP + _SIZE + 16, f"{tick:g}"))
        if x0 == _LEFT:
            body.append(svg.label(x0 - 7, y + 4, f"{tick:g}", "end"))
    body.append(svg.label(x0 + _SIZE / 2, _TOP + _SIZE + 32, f"share decoded by {first}", extra={"opacity": ".7"}))
    return body


def _describe(facts: Mapping[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in facts.items())


def draw_residuals(residuals: Mapping[str, Mapping[tuple[str, bool], Residual]]) -> Figure:
    """Draw the 10th to 90th percentile and the median of each model's loss minus skyrange's, by heights and sight.

    What is beyond `_BEYOND_DB` is an arrow at the edge.
    """
    rows = list(dict.fromkeys(key for found in residuals.values() for key in found))
    spans = [one for found in residuals.values() for one in found.values()]
    low = max(min((one.low_db for one in spans), default=-10.0) - 2.0, -_BEYOND_DB)
    high = min(max((one.high_db for one in spans), default=10.0) + 2.0, _BEYOND_DB)
    step = 9.0 * len(residuals) + 12.0
    left, top, width = 170.0, 44.0, 680.0
    height = top + step * len(rows) + 40.0
    scale = width / (high - low)
    colours = dict(zip(residuals, OKABE_ITO, strict=False))
    body: list[Element] = []
    values, spacing = svg.ticks(low, high, 8)
    for value in values:
        x = left + (value - low) * scale
        body.append(svg.element("path", {"d": f"M{x:.1f} {top:.1f}V{height - 36:.1f}", **svg.GRID}))
        body.append(svg.label(x, height - 20, svg.format_tick(value, spacing)))
    for number, (heights, sight) in enumerate(rows):
        y = top + number * step + 6.0
        body.append(svg.label(left - 10, y + step / 2 - 2, f"{heights}, {'sight' if sight else 'no sight'}", "end"))
        for turn, (model, found) in enumerate(residuals.items()):
            one = found.get((heights, sight))
            if one is None:
                continue
            level = y + 9.0 * turn + 3.0
            a, middle, b = (
                left + (min(max(value, low), high) - low) * scale for value in (one.low_db, one.median_db, one.high_db)
            )
            look: svg.Attributes = {"stroke": colours[model], "stroke-width": 3.0, "stroke-opacity": ".75"}
            said = f"{model}: {one.median_db:+.1f} dB, {one.low_db:+.1f} to {one.high_db:+.1f}, {one.pairs} pairs"
            body.append(svg.element("path", {"d": f"M{a:.1f} {level:.1f}H{b:.1f}", **look}, svg.title(said)))
            if one.median_db > high:
                arrow = f"M{b - 7:.1f} {level - 4:.1f}L{b:.1f} {level:.1f}L{b - 7:.1f} {level + 4:.1f}Z"
                body.append(svg.element("path", {"d": arrow, "fill": colours[model]}, svg.title(said)))
                continue
            body.append(svg.element("circle", {"cx": middle, "cy": level, "r": 3.4, "fill": colours[model]}))
    x = 20.0
    for model, colour in colours.items():
        body.append(svg.element("circle", {"cx": x + 4, "cy": 16.0, "r": 4, "fill": colour}))
        body.append(svg.label(x + 12, 20.0, model, "start"))
        x += 26 + 6.2 * len(model)
    body.append(svg.label(left + width / 2, height - 4, "loss minus skyrange's, dB", extra={"opacity": ".7"}))
    return svg.document(left + width + 20.0, height, "Path losses of the engines' own models", body)
