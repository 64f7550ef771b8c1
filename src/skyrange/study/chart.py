"""How is something drawn over time? One line per aircraft, ticks that read well, as SVG."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from skyrange.study import svg
from skyrange.study.subject import Subject
from skyrange.study.svg import Figure, number
from skyrange.study.thin import kept_rows

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
_MOST_NAMED = 8  # operators whose names fit over a chart
_NOTHING: tuple[Ints, Floats] = (np.zeros(0, dtype=np.int64), np.zeros(0))


def over_time(
    subject: Subject,
    lines: Mapping[str, tuple[Ints, Floats]],
    said: str,
    title: str,
    width: float,
    height: float,
    twins: Mapping[str, tuple[Ints, Floats]] | None = None,
    spans: Sequence[tuple[float, float, str]] = (),
) -> Figure:
    """A line per aircraft of `subject`: by its id (n,) ns and (n,) values; `said` stands over the axis.

    `twins` are drawn dashed behind them. `spans` are times to shade: from, until, in seconds, and their name.
    """
    twins = twins or {}
    drawn = [line for line in (*lines.values(), *twins.values()) if len(line[0])]
    first = min((float(times_ns[0]) for times_ns, _ in drawn), default=0.0) * 1e-9
    last = max(max((float(times_ns[-1]) for times_ns, _ in drawn), default=0.0) * 1e-9, first + 1.0)
    low = min((float(values.min()) for _, values in drawn), default=0.0)
    top = max(max((float(values.max()) for _, values in drawn), default=1.0), low + 1.0) * 1.06
    low = 0.0 if low > -0.05 * top else low
    left, right, above, below = 44.0, 12.0, 22.0, 38.0
    x_scale, y_scale = (width - left - right) / (last - first), (height - above - below) / (top - low)
    body = [svg.text(left, above - 9, said, "start", extra='opacity=".7"')]
    for begin, end, name in spans:
        x = left + (min(max(begin, first), last) - first) * x_scale
        wide = max((min(end, last) - max(begin, first)) * x_scale, 1.0)
        body.append(
            f'<rect class="span" x="{number(x)}" y="{number(above)}" width="{number(wide)}" '
            f'height="{number(height - above - below)}" fill="#b3261e" fill-opacity=".09">'
            f"<title>{escape(name)}</title></rect>"
        )
        body.append(svg.text(x + 4, above + 12, name, "start", 10.5, 'fill-opacity=".75"'))
    values, step = svg.ticks(low, top, 5)
    for value in values:
        level = height - below - (value - low) * y_scale
        body.append(f'<path d="M{number(left)} {number(level)}H{number(width - right)}" {svg.GRID}/>')
        body.append(svg.text(left - 7, level + 4, svg.label(value, step), "end"))
    values, step = svg.ticks(first, last, 8)
    body.extend(
        svg.text(left + (value - first) * x_scale, height - below + 17, svg.label(value, step)) for value in values
    )
    body.append(svg.text((left + width - right) / 2, height - 5, "simulated time, s", extra='opacity=".7"'))
    shown = {name for group in (lines, twins) for name, line in group.items() if len(line[0])}
    body += _legend(subject, shown, width - right, above - 9)
    budget = max(60, svg.POINTS // max(len(subject.fleet), 1))
    for group, dashed in ((twins, True), (lines, False)):
        for vehicle in subject.fleet:
            times_ns, ups = group.get(vehicle.id, _NOTHING)
            rows = kept_rows(times_ns, ups[:, None], budget, 0.3 / y_scale)
            x_pixels = left + (times_ns[rows] * 1e-9 - first) * x_scale
            y_pixels = height - below - (ups[rows] - low) * y_scale
            body.append(subject.line(vehicle, np.stack([x_pixels, y_pixels], axis=1), dashed=dashed))
    return Figure(svg.document(width, height, title, body), title)


def _legend(subject: Subject, shown: Collection[str], right: float, y: float) -> list[str]:
    """The names of the operators of `shown` in their colours, ending at `right`.

    None where the run has but one operator, or too many are shown.
    """
    first = {vehicle.operator: vehicle for vehicle in reversed(subject.fleet) if vehicle.id in shown}
    if len({vehicle.operator for vehicle in subject.fleet}) < 2 or len(first) > _MOST_NAMED:
        return []
    parts = []
    for operator, vehicle in first.items():
        parts.append(
            f'<text x="{number(right)}" y="{number(y)}" text-anchor="end" font-size="11" font-weight="600" '
            f'fill="{subject.inks[vehicle.id].light}">{escape(operator)}</text>'
        )
        right -= 7 * len(operator) + 12
    return parts
