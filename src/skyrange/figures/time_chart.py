"""Line charts over simulated time: one line per aircraft, as SVG."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from skyrange.figures import svg
from skyrange.figures.subject import Subject
from skyrange.figures.svg import Figure, format_number
from skyrange.figures.track_simplification import select_samples

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_MAX_NAMED = 8  # operators whose names fit over a chart
_NOTHING: tuple[Ints, Floats] = (np.zeros(0, dtype=np.int64), np.zeros(0))


def draw_chart(
    subject: Subject,
    lines: Mapping[str, tuple[Ints, Floats]],
    caption: str,
    title: str,
    *,
    size_px: tuple[float, float],
    twins: Mapping[str, tuple[Ints, Floats]] | None = None,
    spans: Sequence[tuple[float, float, str]] = (),
) -> Figure:
    """Draw a line per aircraft of `subject`.

    `lines` are (n,) times in ns and (n,) values by vehicle id; `caption` is the text above the axis. `twins` are drawn
    dashed behind the lines. `spans` are shaded: from and until, in seconds, and a name. `size_px` is width and height.
    """
    twins = twins or {}
    width, height = size_px
    drawn = [line for line in (*lines.values(), *twins.values()) if len(line[0])]
    first = min((float(times_ns[0]) for times_ns, _ in drawn), default=0.0) * 1e-9
    last = max(max((float(times_ns[-1]) for times_ns, _ in drawn), default=0.0) * 1e-9, first + 1.0)
    low = min((float(values.min()) for _, values in drawn), default=0.0)
    top = max(max((float(values.max()) for _, values in drawn), default=1.0), low + 1.0) * 1.06
    low = 0.0 if low > -0.05 * top else low
    left, right, above, below = 44.0, 12.0, 22.0, 38.0
    x_scale, y_scale = (width - left - right) / (last - first), (height - above - below) / (top - low)
    body = [svg.label(left, above - 9, caption, "start", extra={"opacity": ".7"})]
    for begin, end, name in spans:
        x = left + (min(max(begin, first), last) - first) * x_scale
        wide = max((min(end, last) - max(begin, first)) * x_scale, 1.0)
        area: svg.Attributes = {"x": x, "y": above, "width": wide, "height": height - above - below}
        shade = {"class": "span", **area, "fill": "#b3261e", "fill-opacity": ".09"}
        body.append(svg.element("rect", shade, svg.title(name)))
        body.append(svg.label(x + 4, above + 12, name, "start", 10.5, {"fill-opacity": ".75"}))
    values, step = svg.ticks(low, top, 5)
    for value in values:
        level = height - below - (value - low) * y_scale
        across = f"M{format_number(left)} {format_number(level)}H{format_number(width - right)}"
        body.append(svg.element("path", {"d": across, **svg.GRID}))
        body.append(svg.label(left - 7, level + 4, svg.format_tick(value, step), "end"))
    values, step = svg.ticks(first, last, 8)
    body.extend(
        svg.label(left + (value - first) * x_scale, height - below + 17, svg.format_tick(value, step))
        for value in values
    )
    body.append(svg.label((left + width - right) / 2, height - 5, "simulated time, s", extra={"opacity": ".7"}))
    shown = {name for group in (lines, twins) for name, line in group.items() if len(line[0])}
    body += _legend(subject, shown, width - right, above - 9)
    budget = max(60, svg.MAX_POINTS // max(len(subject.fleet), 1))
    for group, dashed in ((twins, True), (lines, False)):
        for vehicle in subject.fleet:
            times_ns, ups = group.get(vehicle.id, _NOTHING)
            rows = select_samples(times_ns, ups[:, None], budget, 0.3 / y_scale)
            x_pixels = left + (times_ns[rows] * 1e-9 - first) * x_scale
            y_pixels = height - below - (ups[rows] - low) * y_scale
            body += subject.draw_line(vehicle, np.stack([x_pixels, y_pixels], axis=1), dashed=dashed)
    return svg.document(width, height, title, body)


def _legend(subject: Subject, shown: Collection[str], right: float, y: float) -> list[Element]:
    """The names of the operators of the vehicles `shown` in their colours, right-aligned at `right`.

    Empty if the run has one operator, or if more than `_MAX_NAMED` are shown.
    """
    first = {vehicle.operator: vehicle for vehicle in reversed(subject.fleet) if vehicle.id in shown}
    if len({vehicle.operator for vehicle in subject.fleet}) < 2 or len(first) > _MAX_NAMED:
        return []
    parts = []
    for operator, vehicle in first.items():
        place: svg.Attributes = {"x": right, "y": y, "text-anchor": "end", "font-size": 11}
        look = {**svg.BOLD, "fill": subject.colours[vehicle.id].light}
        parts.append(svg.element("text", {**place, **look}, text=operator))
        right -= 7 * len(operator) + 12
    return parts
