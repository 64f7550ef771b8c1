"""Figure of a causal path: boxes of steps in lanes of layers, in order of time from left to right, joined by arrows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final
from xml.etree.ElementTree import Element

from skyrange.figures.svg import BOLD, GRID, Figure, document, element, label
from skyrange.twins.causal_path import LAYERS, CausalPath, Step

BOX_W: Final = 136.0
BOX_H: Final = 52.0
GAP_X: Final = 22.0
SHIFT: Final = 92.0
"""How far right of a step the next one of another layer begins."""
LANE_H: Final = 74.0
LEFT: Final = 92.0
TOP: Final = 14.0
_LINE: Final = 22
"""Characters of a line in a box."""


def draw_causal_path(path: CausalPath, link: Callable[[Step], str] | None = None) -> Figure:
    """Draw it. A lane has the steps of one layer; a step stands right of those that led to it.

    With `link`, the box of a step leads to an address.
    """
    order = sorted(range(len(path.steps)), key=lambda number: (path.steps[number].at_s, number))
    left = _positions(path, order)
    lanes = [layer for layer in LAYERS if any(step.layer == layer for step in path.steps)]
    height = TOP + LANE_H * len(lanes) + 10
    width = max(left.values(), default=LEFT) + BOX_W + 6
    body: list[Element] = [_arrow_head()]
    for place, layer in enumerate(lanes):
        y = TOP + place * LANE_H
        body.append(element("path", {"d": f"M0 {y:.1f}H{width:.1f}", **GRID}))
        body.append(label(4, y + LANE_H / 2, layer, "start", 12, BOLD))
    where = {number: (left[number], TOP + lanes.index(path.steps[number].layer) * LANE_H + 11) for number in order}
    body += [_arrow(where[start], where[end], how) for start, end, how in path.edges]
    for number in order:
        step = path.steps[number]
        box = _box(*where[number], step)
        body.append(box if link is None else element("a", {"href": link(step)}, box))
    description = "; ".join(f"{step.at_s:.2f} s {step.owner}: {step.what}" for step in (path.steps[k] for k in order))
    title = "Causal path from the first act to the effects"
    return document(width, height, title, body, description, role="img" if link is None else "group")


def _positions(path: CausalPath, order: list[int]) -> dict[int, float]:
    """The left edge of each step: right of every step that led to it, and of the one before it in its lane."""
    left: dict[int, float] = {}
    last: dict[str, float] = {}
    for number in order:
        layer = path.steps[number].layer
        before = [left[start] + SHIFT for start, end, _ in path.edges if end == number and start in left]
        left[number] = last[layer] = max([LEFT, *before, last.get(layer, LEFT - BOX_W - GAP_X) + BOX_W + GAP_X])
    return left


def _box(x: float, y: float, step: Step) -> Element:
    lines = _wrapped(step.what)
    return element(
        "g",
        {},
        element(
            "rect",
            {"x": x, "y": y, "width": BOX_W, "height": BOX_H, "rx": 5, "fill": "Canvas", "stroke": "currentColor",
             "stroke-opacity": ".45"},
        ),
        label(x + 6, y + 13, f"{step.at_s:.2f} s  {step.owner}", "start", 10, {"opacity": ".75"}),
        *(label(x + 6, y + 28 + 14 * k, line, "start", 11) for k, line in enumerate(lines)),
    )  # fmt: skip


def _wrapped(text: str) -> list[str]:
    """At most two lines."""
    words, lines = text.split(), [""]
    for word in words:
        if len(lines[-1]) + len(word) + 1 > _LINE and lines[-1]:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    if len(lines) > 2:
        lines = [lines[0], f"{lines[1][: _LINE - 1]}…"]
    return lines


def _arrow(start: tuple[float, float], end: tuple[float, float], how: str) -> Element:
    (ax, ay), (bx, by) = start, end
    x1, y1 = bx - 2, by + BOX_H / 2
    if ay != by:
        x0, y0 = (ax + 0.3 * BOX_W, ay + BOX_H) if by > ay else (ax + min(0.85 * BOX_W, bx - ax - 14.0), ay)
        data = f"M{x0:.1f} {y0:.1f}V{y1:.1f}H{x1:.1f}"
    elif bx - ax > BOX_W + GAP_X + 1:  # below the boxes between both
        x0, y0, y1 = ax + 0.85 * BOX_W, ay + BOX_H, by + 0.85 * BOX_H
        data = f"M{x0:.1f} {y0:.1f}v10H{x1 - GAP_X / 2:.1f}V{y1:.1f}H{x1:.1f}"
    else:
        x0, y0 = ax + BOX_W, y1
        data = f"M{x0:.1f} {y0:.1f}H{x1:.1f}"
    line: dict[str, str | float] = {
        "d": data,
        "fill": "none",
        "stroke": "currentColor",
        "stroke-width": 1.4,
        "marker-end": "url(#causal-head)",
    }
    parts = [element("path", line)]
    if how:
        parts.append(label(x0 + 4, (y0 + y1) / 2, how, "start", 10, {"font-style": "italic"}))
    return element("g", {}, *parts)


def _arrow_head() -> Element:
    head = element("path", {"d": "M0 0L7 3L0 6z", "fill": "currentColor"})
    marker: dict[str, str | float] = {
        "id": "causal-head", "markerWidth": 8, "markerHeight": 6, "refX": 6, "refY": 3, "orient": "auto",
    }  # fmt: skip
    return element("defs", {}, element("marker", marker, head))
