"""Figures of a study: dose-response curves with intervals, and interactions of two factors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from skyrange.figures import svg
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure
from skyrange.study.sweep.report.response import Curve, Level

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
