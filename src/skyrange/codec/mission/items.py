"""Mission model: items, their permitted values, and the checks that all file formats share.

Numbering is ArduPilot's: home is item 0 and is not among `Mission.items`, so `items[0]` has sequence number 1, and a
DO_JUMP's `param1` refers to these numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NoReturn

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyrange.codec.mission.ignored_keys import Ignored
from skyrange.core.errors import InputError, Problem

MAX_FILE_BYTES = 16 * 1024 * 1024
MAX_ITEMS = 65_534
"""The most that MISSION_COUNT's 16 bits can count, home included."""
MAX_PROBLEMS = 50
"""At most this many problems of one file are listed."""

FRAMES: dict[int, str] = {
    number: entry.name
    for number, entry in dialect.enums["MAV_FRAME"].items()
    if "RESERVED" not in entry.name and "ENUM_END" not in entry.name
}
GLOBAL_FRAMES = frozenset(number for number, name in FRAMES.items() if name.startswith("MAV_FRAME_GLOBAL"))
LOCAL_FRAMES = frozenset(FRAMES) - GLOBAL_FRAMES - {dialect.MAV_FRAME_MISSION}
LOCATED_COMMANDS = frozenset(number for number, entry in dialect.enums["MAV_CMD"].items() if entry.has_location)
"""Commands whose x, y, z are a position (`hasLocation` in the MAVLink definitions); elsewhere they are parameters 5 to
7."""
TAKEOFFS = frozenset({dialect.MAV_CMD_NAV_TAKEOFF, dialect.MAV_CMD_NAV_VTOL_TAKEOFF})
LANDINGS = frozenset({dialect.MAV_CMD_NAV_LAND, dialect.MAV_CMD_NAV_VTOL_LAND})
"""Take-offs and landings may leave latitude and longitude unspecified: 0, 0 means "here" to ArduPilot."""

_FLOAT32_MAX = 3.4028234663852886e38
_INT32_MAX = 2**31 - 1
_LOCAL_SCALE = 1e4
"""MISSION_ITEM_INT carries local x and y in units of 0.1 mm."""

VALUES = ("param1", "param2", "param3", "param4", "x", "y", "z")


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One mission item, in the units of MAVLink's MISSION_ITEM.

    `frame` is a MAV_FRAME, `command` a MAV_CMD. `x`, `y` are latitude and longitude in degrees for global frames,
    metres for local ones, parameters 5 and 6 for commands without a position; `z` is the altitude in metres by the
    frame's datum, or parameter 7. `param1` to `param4` may be NaN, MAVLink's "not specified"; x, y, z are always
    finite.
    """

    frame: int
    command: int
    param1: float
    param2: float
    param3: float
    param4: float
    x: float
    y: float
    z: float
    autocontinue: bool = True

    @property
    def values(self) -> tuple[float, float, float, float, float, float, float]:
        """param1 … param4, x, y, z."""
        return self.param1, self.param2, self.param3, self.param4, self.x, self.y, self.z


@dataclass(frozen=True, slots=True)
class Mission:
    """A mission as read from a file.

    `home` is (latitude °, longitude °, altitude m above mean sea level), or `None` if the file names none. `fence` and
    `rally` are the items of a plan's fence and rally points (`fence_and_rally`). `settings` are its further mission
    keys (`cruiseSpeed`, `hoverSpeed`, `vehicleType`, …). `source` names the file in messages; `ignored` is what it says
    and a flight does not use.
    """

    items: tuple[MissionItem, ...]
    home: tuple[float, float, float] | None = None
    fence: tuple[MissionItem, ...] = ()
    rally: tuple[MissionItem, ...] = ()
    source: str = ""
    settings: Mapping[str, object] | None = None
    ignored: tuple[Ignored, ...] = field(default=(), compare=False)


class ProblemCollector:
    """Collects the problems of one file, to raise them all at once."""

    def __init__(self, who: str) -> None:
        self.who = who
        self.found: list[Problem] = []
        self.total = 0

    def add(self, where: str, value: object, expected: str, hint: str = "") -> None:
        """Add a problem; beyond `MAX_PROBLEMS` problems are only counted."""
        self.total += 1
        if len(self.found) < MAX_PROBLEMS:
            self.found.append(Problem(where, quote_value(value), expected, hint))

    def stop(self, where: str, value: object, expected: str, hint: str = "") -> NoReturn:
        """Add a problem and raise all of them: reading cannot go on."""
        self.add(where, value, expected, hint)
        raise InputError(self.who, self.found)

    def raise_if_any(self) -> None:
        """Raise `InputError` if any problem was added."""
        if self.total > len(self.found):
            self.found.append(Problem("further on", f"{self.total - len(self.found)} more problems", "none"))
        if self.found:
            raise InputError(self.who, self.found)


def quote_value(value: object) -> str:
    """A value as problems quote it: at most 60 characters."""
    text = repr(value[:61] if isinstance(value, str | list) else value)
    return text if len(text) <= 60 else text[:59] + "…"


HOME_EXPECTED = "a latitude in -90…90° and a longitude in -180…180°, an altitude within ±2147 km"


def is_valid_home(lat_deg: float, lon_deg: float, alt_m: float) -> bool:
    """Whether HOME_POSITION can hold these values: degrees in range, millimetres in 32 bits."""
    return abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0 and abs(alt_m) * 1e3 <= _INT32_MAX


def check_item(
    frame: int,
    command: int,
    values: Sequence[float],
    positions: Sequence[str],
    problems: ProblemCollector,
    *,
    autocontinue: bool,
) -> MissionItem | None:
    """The item with `values` (param1 … param4, x, y, z), or `None` and a problem for each value that is not permitted.

    `positions` names each value's position in the file. Ranges are MISSION_ITEM_INT's. An unspecified (NaN) x, y or z
    becomes 0 where that means "here" or has no meaning: all three for commands without a position, x and y for
    take-off and landing, z for landing.
    """
    before = problems.total
    open_here = _optional_values(command)
    settled = []
    for name, value, where in zip(VALUES, values, positions, strict=True):
        if math.isnan(value):
            if name in open_here:
                settled.append(0.0)
                continue
            if name in ("x", "y", "z"):
                problems.add(where, value, f"a number: {_meaning(frame, command, name)}")
        elif not abs(value) <= _FLOAT32_MAX:
            problems.add(where, value, "a finite number that fits 32-bit floating point")
        elif name in ("x", "y") and abs(value) > (limit := _limit(frame, command, name)):
            problems.add(where, value, f"{_meaning(frame, command, name)} in -{limit:.10g}…{limit:.10g}")
        settled.append(value)
    if problems.total > before:
        return None
    param1, param2, param3, param4, x, y, z = settled
    return MissionItem(frame, command, param1, param2, param3, param4, x, y, z, autocontinue)


def _optional_values(command: int) -> tuple[str, ...]:
    if command not in LOCATED_COMMANDS or command in LANDINGS:
        return ("x", "y", "z")
    return ("x", "y") if command in TAKEOFFS else ()


def _limit(frame: int, command: int, name: str) -> float:
    if frame in GLOBAL_FRAMES and command in LOCATED_COMMANDS:
        return 90.0 if name == "x" else 180.0
    return _INT32_MAX / _LOCAL_SCALE if frame in LOCAL_FRAMES else float(_INT32_MAX)


def _meaning(frame: int, command: int, name: str) -> str:
    if command not in LOCATED_COMMANDS:
        return f"parameter {VALUES.index(name) + 1}"
    if frame in GLOBAL_FRAMES:
        return {"x": "a latitude in degrees", "y": "a longitude in degrees", "z": "an altitude in metres"}[name]
    return f"{name} in metres"


def expected_frames() -> str:
    """The MAV_FRAME values that a file may use."""
    return "one of " + ", ".join(f"{number} {name[10:]}" for number, name in sorted(FRAMES.items()))
