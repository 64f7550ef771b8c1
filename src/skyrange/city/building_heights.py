r"""Building heights from the attributes that cities and maps publish.

`height` and `min_height` are metres unless a unit is given (OSM wiki, Key:height: "17.5", "17.5 m", "55 ft", "55'",
"55'6\""). `building:levels` counts storeys of 3 m, as the examples of the wiki's page on multi-level shapes do (2
levels 6 m, 5 levels 15 m). Other names are those of CityGML and CityJSON (`measuredHeight`, `storeysAboveGround`), of
OpenMapTiles (`render_height`), of Overture Maps (`num_floors`) and of cities; names are compared without case, and as
Shapefiles cut them off after ten characters. With none of them, a building has the height that its 3-D coordinates
span, and otherwise `DEFAULT_HEIGHT_M`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Final, Literal, NamedTuple

STOREY_M = 3.0
DEFAULT_HEIGHT_M = 9.0
"""Three storeys: our own assumption for a building without tags for its height."""
FOOT_M = 0.3048
"""International foot (exact, 1959)."""

METRE_KEYS: Final = (
    "height", "measuredheight", "measured_height", "measuredhe", "measured_h", "render_height", "render_hei",
    "building:height", "building_height", "building_h", "bldg_height", "height_m", "hoehe", "hauteur",
)  # fmt: skip
"""Names of a height above the ground in metres, in the order in which they are tried; without case."""
FOOT_KEYS: Final = ("heightroof", "height_roof", "height_ft")
"""The same in feet: `heightroof` and `height_roof` are those of New York's building footprints."""
STOREY_KEYS: Final = (
    "building:levels", "building_levels", "building_l", "storeysaboveground", "storeysabo", "num_floors", "numfloors",
    "floors", "levels", "storeys", "stories", "nb_etages",
)  # fmt: skip
"""Names of a number of storeys above the ground."""
BASE_KEYS: Final = ("min_height", "render_min_height", "building:min_height")
"""Names of a bottom above the ground, in metres."""
_BASE_STOREY_KEYS: Final = ("building:min_level", "min_floor")
KEYS: Final = frozenset((*METRE_KEYS, *FOOT_KEYS, *STOREY_KEYS, *BASE_KEYS, *_BASE_STOREY_KEYS))
"""Every name that this module reads, in lower case."""

_MOST_SPAN_M: Final = 1000.0  # no building is higher: such coordinates are not heights in metres
_LEAST_SPAN_M: Final = 1.0

_METRES = re.compile(r"(\d{1,5}(?:\.\d{1,6})?)\s*(?:m|metre|metres|meter|meters)?", re.ASCII)
_FEET = re.compile(
    r"(\d{1,5}(?:\.\d{1,6})?)\s*(?:'|ft|foot|feet)(?:\s*(\d{1,2}(?:\.\d{1,6})?)\s*(?:\"|''|in))?", re.ASCII
)

HeightSource = Literal["measured", "derived", "defaulted"]
"""Where a height is from: an attribute in metres or feet; storeys or 3-D coordinates; nothing."""


class BuildingHeight(NamedTuple):
    """The height of a building, and where it is from."""

    height_m: float
    """Top above the ground."""
    base_m: float
    """Bottom above the ground."""
    source: HeightSource
    key: str
    """The attribute that gave the height, `3-D coordinates`, or empty if it is the default."""
    unreadable: bool
    """Whether the building has a height attribute that is no length."""


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


def height_of(tags: Mapping[str, Any], span_m: float = 0.0) -> BuildingHeight:
    """The height of a building or building part by its tags, or by `span_m`, what its 3-D coordinates span.

    A tag that cannot be read is skipped in favour of the next best one. A base at or above the top is ignored.
    """
    named = {key.lower(): key for key in tags if key.lower() in KEYS}
    height_tags = {name: tags[key] for name, key in named.items() if tags[key] not in (None, "")}
    height_m, source, key, unreadable = _top(height_tags, span_m)
    base_m = next((base for name in BASE_KEYS if (base := parse_length(height_tags.get(name)))), None)
    if base_m is None:
        base_m = next((base for name in _BASE_STOREY_KEYS if (base := _storeys(height_tags.get(name)))), 0.0)
    return BuildingHeight(height_m, base_m if base_m < height_m else 0.0, source, named.get(key, key), unreadable)


def _top(height_tags: Mapping[str, Any], span_m: float) -> tuple[float, HeightSource, str, bool]:
    unreadable = False
    for name in (*METRE_KEYS, *FOOT_KEYS):
        if name in height_tags:
            metres = parse_length(height_tags[name])
            if metres is not None:
                return metres * (FOOT_M if name in FOOT_KEYS else 1.0), "measured", name, unreadable
            unreadable = True
    if _LEAST_SPAN_M <= span_m <= _MOST_SPAN_M:
        return span_m, "derived", "3-D coordinates", unreadable
    for name in STOREY_KEYS:
        if name in height_tags:
            metres = _storeys(height_tags[name])
            if metres is not None:
                return metres, "derived", name, unreadable
            unreadable = True
    return DEFAULT_HEIGHT_M, "defaulted", "", unreadable


def _storeys(value: object) -> float | None:
    """Metres of a number of storeys; the number may have a fraction but no unit."""
    count = parse_length(value) if isinstance(value, int | float) or re.fullmatch(r"[\d.\s]+", str(value)) else None
    return None if count is None else count * STOREY_M
