"""SVG elements (numbers, ticks, paths, text and documents), and figures as PDF.

A drawing is a tree of `xml.etree.ElementTree` elements, which escapes all text when it is written. It contains no
reference that a viewer would have to fetch.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.core.extras import describe_install
from skyrange.core.files import atomic_write

Floats = NDArray[np.float64]
Attributes = Mapping[str, str | float]
"""An element's attributes by name; numbers are pixels (`format_number`)."""

MAX_POINTS: Final = 24_000
"""Samples drawn in one figure, divided evenly among its aircraft."""

GRID: Final = {"stroke": "currentColor", "stroke-opacity": ".16", "fill": "none"}
"""Attributes of grid lines."""

BOLD: Final = {"font-weight": "600"}
"""Attributes of bold text."""

FONT: Final = "system-ui,-apple-system,'Segoe UI',Roboto,'Helvetica Neue',sans-serif"


@dataclass(frozen=True, slots=True)
class Figure:
    """A drawing, which notebooks display. `svg` is an `<svg>` element, `title` says what it shows."""

    svg: str
    title: str

    def _repr_svg_(self) -> str:
        return self.svg

    def _repr_html_(self) -> str:
        return f'<div style="max-width:100%;overflow-x:auto">{self.svg}</div>'

    def __html__(self) -> str:
        """The drawing as markup, which templates do not escape."""
        return self.svg

    def save(self, path: str | Path) -> Path:
        """Write it as an `.svg` file and return its path."""
        target = Path(path)
        with atomic_write(target) as file:
            file.write(f'<?xml version="1.0" encoding="UTF-8"?>\n{self.svg}'.encode())
        return target


def element(tag: str, attributes: Attributes, *children: Element, text: str = "") -> Element:
    """An element that holds `text`, then `children`."""
    made = Element(
        tag, {name: value if isinstance(value, str) else format_number(value) for name, value in attributes.items()}
    )
    made.text = text or None
    made.extend(children)
    return made


def format_number(value: float) -> str:
    """A number with at most one decimal, without trailing zero or minus zero; 0.1 pixels is precise enough."""
    text = f"{value:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text


def format_tick(value: float, step: float) -> str:
    """The text of a tick, with as many decimals as `step` needs and a typographic minus sign."""
    decimals = max(0, -math.floor(math.log10(step) + 1e-9)) if step < 1 else 0
    text = f"{value:.{decimals}f}"
    return "0" if float(text) == 0 else text.replace("-", "−")


def round_step(span: float, about: int) -> float:
    """1, 2 or 5 times a power of ten, so that `span` (> 0) contains about `about` steps."""
    rough = max(span, 1e-9) / max(about, 1)
    power: float = 10.0 ** math.floor(math.log10(rough))
    return next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= rough * 0.999)


_MAX_SPAN: Final = 1e15


def ticks(low: float, high: float, about: int = 5) -> tuple[list[float], float]:
    """Round values in [low, high] and the step between them; none between limits that cannot be drawn."""
    if not abs(high - low) < _MAX_SPAN or not abs(low) < _MAX_SPAN:
        return [], 1.0
    step = round_step(high - low, about)
    first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
    return [index * step for index in range(first, last + 1)], step


def path_data(points: Floats, *, close: bool = False) -> str:
    """The `d` of a path through (n, 2) pixels, in relative steps, tenths of a pixel."""
    if not len(points):
        return ""
    tenths = np.rint(points * 10).astype(np.int64)
    moves = np.diff(tenths, axis=0)
    moves = moves[(moves != 0).any(axis=1)]
    start = f"M{format_number(tenths[0, 0] / 10)} {format_number(tenths[0, 1] / 10)}"
    steps = " ".join(f"{format_number(dx / 10)} {format_number(dy / 10)}" for dx, dy in moves.tolist())
    return start + (f"l{steps}" if steps else "h0") + ("z" if close else "")


def title(text: str) -> Element:
    """The `<title>` of an element, which viewers show under the pointer."""
    return element("title", {}, text=text)


def label(
    x: float,
    y: float,
    text: str,
    anchor: str = "middle",
    size: float = 11,
    extra: Attributes | None = None,
) -> Element:
    """A `<text>` element at a pixel, in the colour of its surroundings unless the `extra` attributes name another."""
    place: Attributes = {"x": x, "y": y, "text-anchor": anchor, "font-size": size, "fill": "currentColor"}
    return element("text", {**place, **(extra or {})}, text=text)


def document(
    width: float, height: float, heading: str, body: Iterable[Element], description: str = "", *, role: str = "img"
) -> Figure:
    """A figure of `width` × `height` pixels with a title for screen readers; text and axes take the page's colour.

    The role is `group` where something in it leads elsewhere.
    """
    root = element(
        "svg",
        {
            "xmlns": "http://www.w3.org/2000/svg",
            "class": "figure",
            "viewBox": f"0 0 {format_number(width)} {format_number(height)}",
            "width": width,
            "height": height,
            "role": role,
            "aria-label": heading,
            "font-family": FONT,
            "preserveAspectRatio": "xMidYMid meet",
        },
        title(heading),
        *([element("desc", {}, text=description)] if description else []),
        *body,
    )
    return Figure(ElementTree.tostring(root, encoding="unicode"), heading)


def save_pdf(figure: Figure, path: Path) -> Path:
    """Write a figure as a PDF of one page of its size, 1 px as 0.75 pt, and return its path. Text stays text.

    Raises `InputError` if CairoSVG or the library cairo is not installed.
    """
    converter = load_converter()
    with atomic_write(path) as file:
        file.write(converter.svg2pdf(bytestring=figure.svg.encode()))
    return path


def load_converter() -> Any:
    """The module `cairosvg`. Raises `InputError` if it or the library cairo is not installed."""
    try:
        return import_module("cairosvg")
    except (ImportError, OSError) as error:  # OSError: the system has no library cairo
        reason = str(error).splitlines()[0]
        hint = f"{describe_install('study')}, and cairo by the system's packages (libcairo2)."
        raise InputError.one("study", "pdf", reason, "the packages CairoSVG and cairo", hint) from error
