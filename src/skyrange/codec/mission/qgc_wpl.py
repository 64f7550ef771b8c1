"""Plain-text mission files in the format `QGC WPL 110`: reading and writing.

The format of https://mavlink.io/en/file_formats/ ("Mission Plain-Text File Format"): a header line, then twelve
columns per item. As ArduPilot and Mission Planner write it, item 0 is home. Columns may be separated by tabs or
spaces; blank lines and lines starting with `#` are skipped, as pymavlink does.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyrange.codec.mission.fence_and_rally import ZONE_COMMANDS
from skyrange.codec.mission.ignored_keys import Ignored
from skyrange.codec.mission.items import (
    FRAMES,
    GLOBAL_FRAMES,
    HOME_EXPECTED,
    MAX_ITEMS,
    Mission,
    MissionItem,
    ProblemCollector,
    check_item,
    expected_frames,
    is_valid_home,
)

HEADER = "QGC WPL 110"
COLUMNS = (
    "sequence",
    "current",
    "frame",
    "command",
    "param1",
    "param2",
    "param3",
    "param4",
    "x (latitude)",
    "y (longitude)",
    "z (altitude)",
    "autocontinue",
)
FENCE_HINT = (
    "Put the fence into the plan of the scenario, in metres from the start (`fence.polygons`, `fence.circles`), and "
    "rally points beside it (`rally`), or all three into a QGroundControl .plan."
)
"""What to do with the lists of fences and rally points that Mission Planner and MAVProxy write."""
_PAIR = re.compile(r"[+-]?[0-9.]{1,40}[\s,]+[+-]?[0-9.]{1,40}", re.ASCII)
_INTEGER = re.compile(r"[0-9]{1,6}", re.ASCII)
_NUMBER = re.compile(r"[+-]?([0-9]{1,400}(\.[0-9]{0,400})?|\.[0-9]{1,400})([eE][+-]?[0-9]{1,4})?|nan", re.I | re.ASCII)


def parse_waypoints(text: str, name: str) -> Mission:
    """Parse the mission in `text`; `name` is the file's name in errors.

    Items are numbered by their order, as pymavlink and MAVProxy do: the first column may have gaps, and a DO_JUMP means
    the item that will have its number. `nan` is permitted in parameters 1 to 4. A home of 0, 0 counts as none. Raises
    `InputError` with line, column, value and expectation of everything wrong.
    """
    problems = ProblemCollector(name)
    lines = [(number, line.strip()) for number, line in enumerate(text.split("\n"), start=1)]
    lines = [(number, line) for number, line in lines if line and not line.startswith("#")]
    if not lines or lines[0][1].split() != HEADER.split():
        # not quoted: the file may be none of this user's, linked to by a scenario of somebody else
        number, line = lines[0] if lines else (1, "")
        value, hint = (line, "") if line.startswith("QGC WPL") else ("another text", "")
        if len(lines) > 1 and all(_PAIR.fullmatch(text) for _, text in lines):
            value, hint = "pairs of numbers, as of a fence list", FENCE_HINT
        problems.stop(f"line {number}", value, f"`{HEADER}`", hint)
    if len(lines) < 2:
        problems.stop("file", "no items", "the home position as item 0, then the mission's items")
    if len(lines) - 2 > MAX_ITEMS:
        problems.stop("file", f"{len(lines) - 2} items", f"at most {MAX_ITEMS}")
    items = [_item(number, line, problems) for number, line in lines[1:]]
    home = items[0]
    if home is not None:
        _check_home(home, lines[1][0], problems)
    problems.raise_if_any()
    whole = [item for item in items if item is not None]
    zones = sum(item.command in ZONE_COMMANDS for item in whole[1:])
    if zones:
        problems.stop("file", f"{zones} items of a fence or of rally points", "a mission alone", FENCE_HINT)
    position = (whole[0].x, whole[0].y, whole[0].z)
    return Mission(
        items=tuple(whole[1:]),
        home=position if position[:2] != (0.0, 0.0) else None,
        source=name,
        ignored=tuple(_list_ignored(lines)),
    )


def _list_ignored(lines: Sequence[tuple[int, str]]) -> Iterator[Ignored]:
    """What the columns say that the order of the lines overrules."""
    rows = [line.split()[:2] for _, line in lines[1:]]
    numbers = [int(sequence) for sequence, _ in rows]
    if numbers != list(range(len(rows))):
        astray = sum(number != place for place, number in enumerate(numbers))
        yield Ignored("sequence", astray, "items are numbered by the order of their lines", harmless=False)
    current = sum(int(flag) for _, flag in rows[1:])
    if current:
        yield Ignored("current", current, "a flight begins with the first item", harmless=False)


def format_waypoints(mission: Mission) -> str:
    """Format `mission` as text from which `parse_waypoints` reads the same items; fence, rally points and settings are
    lost.

    Home becomes item 0, all zeros if there is none.
    """
    home = mission.home or (0.0, 0.0, 0.0)
    first = MissionItem(dialect.MAV_FRAME_GLOBAL, dialect.MAV_CMD_NAV_WAYPOINT, 0.0, 0.0, 0.0, 0.0, *home)
    lines = [HEADER]
    for sequence, item in enumerate((first, *mission.items)):
        columns = [
            sequence,
            int(sequence == 0),
            item.frame,
            item.command,
            *map(float, item.values),
            int(item.autocontinue),
        ]
        lines.append("\t".join(map(repr, columns)))
    return "\n".join(lines) + "\n"


def _item(line_number: int, line: str, problems: ProblemCollector) -> MissionItem | None:
    """The item of one line, or `None` and some problems."""
    before = problems.total
    cells = line.split()
    if len(cells) != len(COLUMNS):
        problems.add(f"line {line_number}", f"{len(cells)} columns", f"{len(COLUMNS)}: {', '.join(COLUMNS)}")
        return None
    positions = [f"line {line_number}, column {place} ({column})" for place, column in enumerate(COLUMNS, start=1)]
    whole: dict[int, int] = {}
    for place, highest in ((0, MAX_ITEMS), (1, 1), (2, 255), (3, 65_535), (11, 1)):
        if _INTEGER.fullmatch(cells[place]) and int(cells[place]) <= highest:
            whole[place] = int(cells[place])
        else:
            problems.add(positions[place], cells[place], f"a whole number in 0…{highest}")
    if whole.get(2, 0) not in FRAMES:
        problems.add(positions[2], cells[2], expected_frames())
    values = []
    for place in range(4, 11):
        if _NUMBER.fullmatch(cells[place]):
            value = float(cells[place])
            values.append(math.nan if math.isnan(value) else value)
        else:
            problems.add(positions[place], cells[place], "a number")
    if problems.total > before:
        return None
    return check_item(whole[2], whole[3], values, positions[4:11], problems, autocontinue=whole[11] == 1)


def _check_home(home: MissionItem, line_number: int, problems: ProblemCollector) -> None:
    """Check that item 0 is a position: Mission Planner writes home with command 0; any other command would never be
    flown.
    """
    if home.command not in (0, dialect.MAV_CMD_NAV_WAYPOINT) or home.frame not in GLOBAL_FRAMES:
        problems.add(
            f"line {line_number}",
            f"command {home.command} in frame {home.frame}",
            "home: a waypoint (command 16) in a global frame",
            "Item 0 of a QGC WPL file is the home position, the mission starts with item 1.",
        )
    if not is_valid_home(home.x, home.y, home.z):
        problems.add(f"line {line_number}", (home.x, home.y, home.z), HOME_EXPECTED)
