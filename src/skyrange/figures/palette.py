"""Colours of operators and shades of their aircraft, for light and dark backgrounds.

Operators without a colour get one of the Okabe–Ito palette (Okabe & Ito, "Color Universal Design", 2008), whose colours
can be distinguished with any common colour vision; colour names mean the nearest colour of that palette. Shades are
made in Oklab (Ottosson, 2020, https://bottosson.github.io/posts/oklab/), where equal steps of lightness look equal, and
have at least the 3:1 contrast that WCAG 2.2 requires of graphics (success criterion 1.4.11).
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

OKABE_ITO = ("#0072b2", "#009e73", "#d55e00", "#cc79a7", "#56b4e9", "#e69f00", "#f0e442")
PAPER = {"light": "#ffffff", "dark": "#10151f"}
"""Background of the figures in each colour scheme."""

_NAMES = {
    "blue": "#0072b2",
    "green": "#009e73",
    "red": "#d55e00",
    "orange": "#e69f00",
    "yellow": "#f0e442",
    "pink": "#cc79a7",
    "magenta": "#cc79a7",
    "purple": "#8c6bb1",
    "violet": "#8c6bb1",
    "cyan": "#56b4e9",
    "lightblue": "#56b4e9",
    "skyblue": "#56b4e9",
    "teal": "#1b9e9e",
    "brown": "#8c5a2b",
    "gray": "#8a93a0",
    "grey": "#8a93a0",
    "black": "#3b424d",
    "white": "#c9d1dc",
}
_HEX = re.compile(r"^#(?:[0-9a-fA-F]{3}|[0-9a-fA-F]{6})$")

_TO_LMS = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_TO_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


class ThemeColour(NamedTuple):
    """A colour for light and for dark pages, each `#rrggbb`."""

    light: str
    dark: str


def base_colours(wanted: dict[str, str]) -> dict[str, str]:
    """`#rrggbb` per operator: the colour it asks for (hex or a common name), else the next unused of the palette."""
    chosen_colours = {operator: _parsed(text) for operator, text in wanted.items()}
    used_colours = {colour for colour in chosen_colours.values() if colour}
    free = [colour for colour in OKABE_ITO if colour not in used_colours] or list(OKABE_ITO)
    result = {}
    for operator, colour in chosen_colours.items():
        if colour is None:
            colour = free[0]
            free = [*free[1:], free[0]]
        result[operator] = colour
    return result


def theme_colour(colour: str) -> ThemeColour:
    """`colour` with its lightness changed as little as needed for contrast on light and on dark pages."""
    return ThemeColour(_against(colour, PAPER["light"], -0.02), _against(colour, PAPER["dark"], +0.02))


def shades(colour: str, count: int) -> list[ThemeColour]:
    """`count` shades of `colour` from darker to lighter; with more than five, the five repeat."""
    steps = min(max(count, 1), 5)
    offsets = [0.0] if steps == 1 else list(np.linspace(-0.5, 0.5, steps) * min(0.08 * (steps - 1), 0.24))
    plain = theme_colour(colour)
    light = _spread(plain.light, offsets, PAPER["light"])
    dark = _spread(plain.dark, offsets, PAPER["dark"])
    made = [ThemeColour(*pair) for pair in zip(light, dark, strict=True)]
    return [made[index % steps] for index in range(count)]


def contrast(first: str, second: str) -> float:
    """The WCAG contrast ratio of two colours, 1…21."""
    a, b = sorted((float(_linear(colour) @ _LUMINANCE) for colour in (first, second)), reverse=True)
    return (a + 0.05) / (b + 0.05)


def _parsed(text: str) -> str | None:
    text = text.strip()
    if _HEX.fullmatch(text):
        return text.lower() if len(text) == 7 else "#" + "".join(2 * digit for digit in text[1:].lower())
    return _NAMES.get(text.lower().replace(" ", "").replace("-", ""))


def _spread(colour: str, offsets: list[float], paper: str) -> list[str]:
    """`colour` at several lightnesses, all shifted away from `paper` until each has enough contrast."""
    away = -0.02 if paper == PAPER["light"] else 0.02
    for step in range(30):
        made = [_lighter(colour, offset + step * away) for offset in offsets]
        if min(contrast(made_colour, paper) for made_colour in made) >= 3.0:
            break
    return made


def _against(colour: str, paper: str, step: float) -> str:
    made = colour
    for count in range(1, 51):
        if contrast(made, paper) >= 3.0:
            break
        made = _lighter(colour, count * step)
    return made


def _linear(colour: str) -> NDArray[np.float64]:
    srgb = np.array([int(colour[index : index + 2], 16) for index in (1, 3, 5)]) / 255.0
    result: NDArray[np.float64] = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return result


def _lighter(colour: str, step: float) -> str:
    """`colour` with Oklab lightness raised by `step`, clipped into sRGB."""
    lab = _TO_LAB @ np.cbrt(_TO_LMS @ _linear(colour))
    lab[0] = min(max(lab[0] + step, 0.0), 1.0)
    linear = np.clip(np.linalg.solve(_TO_LMS, np.linalg.solve(_TO_LAB, lab) ** 3), 0.0, 1.0)
    srgb = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    return "#" + "".join(f"{round(float(channel) * 255):02x}" for channel in srgb)
