"""Figure of a comparison of variants: the mean delay of each operator's flights."""

from __future__ import annotations

from typing import Final

from skyrange.figures import svg
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure
from skyrange.study.variants.flights import Comparison

_LEFT: Final = 110.0
_TOP: Final = 46.0
_BAR: Final = 13.0
_GAP: Final = 12.0
_WIDE: Final = 560.0
_KEY: Final = 132.0


def draw_delays(result: Comparison) -> Figure | None:
    """Bars by operator and variant, with lines for the intervals; `None` if nobody was delayed."""
    delays = {variant: result.delays_s(variant) for variant in result.changes}
    operators = list(dict.fromkeys(name for own in delays.values() for name in own))
    most = max((mean.high or mean.mean for own in delays.values() for mean in own.values()), default=0.0)
    if most <= 0.0:
        return None
    values, step = svg.ticks(0.0, most)
    scale = _WIDE / most
    high = len(delays) * _BAR + _GAP
    height = _TOP + len(operators) * high + 40
    body = []
    for k, variant in enumerate(delays):
        x = _LEFT + _KEY * (k % 5)
        y = 14.0 + 14.0 * (k // 5)
        body.append(svg.element("rect", {"x": x, "y": y - 8, "width": 10, "height": 10, "fill": _colour(k)}))
        body.append(svg.label(x + 15, y + 1, variant, "start"))
    foot = _TOP + len(operators) * high
    for value in values:
        x = _LEFT + value * scale
        body.append(svg.element("path", {"d": f"M{x:.1f} {_TOP - 6}V{foot:.1f}", **svg.GRID}))
        body.append(svg.label(x, foot + 15, svg.format_tick(value, step)))
    body.append(svg.label(_LEFT + _WIDE, foot + 31, "mean delay (s)", "end", 10.5, {"opacity": ".7"}))
    for n, operator in enumerate(operators):
        top = _TOP + n * high
        body.append(svg.label(_LEFT - 10, top + (high - _GAP) / 2 + 4, operator, "end"))
        for k, (variant, own) in enumerate(delays.items()):
            mean = own.get(operator)
            if mean is None:
                continue
            y, width = top + k * _BAR, max(mean.mean, 0.0) * scale
            said = svg.title(f"{operator}, {variant}: {mean.mean:.1f} s")
            place: svg.Attributes = {"x": _LEFT, "y": y + 1, "width": max(width, 1.0), "height": _BAR - 2}
            body.append(svg.element("rect", {**place, "fill": _colour(k)}, said))
            if mean.low is not None and mean.high is not None:
                line = f"M{_LEFT + mean.low * scale:.1f} {y + _BAR / 2:.1f}H{_LEFT + mean.high * scale:.1f}"
                body.append(svg.element("path", {"d": line, "stroke": "currentColor", "stroke-width": "1.5"}))
    return svg.document(_LEFT + _WIDE + 30, height, f"Delays by operator: {result.name}", body)


def _colour(number: int) -> str:
    return OKABE_ITO[number % len(OKABE_ITO)]
