r"""Building heights from OpenStreetMap tags.

`height` and `min_height` are metres unless a unit is given (OSM wiki, Key:height: "17.5", "17.5 m", "55 ft", "55'",
"55'6\""). `building:levels` counts storeys of 3 m, as the examples of the wiki's page on multi-level shapes do (2
levels 6 m, 5 levels 15 m). With neither, a building has `DEFAULT_HEIGHT_M`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Literal

STOREY_M = 3.0
DEFAULT_HEIGHT_M = 9.0
"""Three storeys: our own assumption for a building without tags for its height."""
FOOT_M = 0.3048
"""International foot (exact, 1959)."""

_METRES = re.compile(r"(\d{1,5}(?:\.\d{1,6})?)\s*(?:m|metre|metres|meter|meters)?", re.ASCII)
_FEET = re.compile(
    r"(\d{1,5}(?:\.\d{1,6})?)\s*(?:'|ft|foot|feet)(?:\s*(\d{1,2}(?:\.\d{1,6})?)\s*(?:\"|''|in))?", re.ASCII
)

HeightSource = Literal["height", "levels", "default"]


def parse_length(value: object) -> float | None:
    """Metres of a tag's value (text or a JSON number), or None if it is not a positive length."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        metres = float(value) if abs(value) < 1e6 else math.nan
    else:
        text = str(value).strip().lower()
        if match := _METRES.fullmatch(text):
            metres = float(match[1])
        elif match := _FEET.fullmatch(text):
            metres = (float(match[1]) + float(match[2] or 0.0) / 12.0) * FOOT_M
        else:
            return None
    return metres if metres > 0.0 else None


def height_of(tags: Mapping[str, Any]) -> tuple[float, float, HeightSource]:
    """(height_m, base_m, source of the height) of a building's or building part's tags.

    A tag that cannot be read is skipped in favour of the next best one. A base at or above the top is ignored.
    """
    source: HeightSource = "height"
    height_m = parse_length(tags.get("height"))
    if height_m is None:
        source = "levels"
        height_m = _storeys(tags.get("building:levels"))
    if height_m is None:
        source = "default"
        height_m = DEFAULT_HEIGHT_M
    base_m = parse_length(tags.get("min_height")) or _storeys(tags.get("building:min_level")) or 0.0
    return height_m, base_m if base_m < height_m else 0.0, source


def _storeys(value: object) -> float | None:
    """Metres of a number of storeys; the number may have a fraction but no unit."""
    count = parse_length(value) if isinstance(value, int | float) or re.fullmatch(r"[\d.\s]+", str(value)) else None
    return None if count is None else count * STOREY_M
