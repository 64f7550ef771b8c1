"""Mission files: QGC WPL 110 and QGroundControl plans, recognised by their content."""

from __future__ import annotations

import os
from pathlib import Path

from skyrange.codec.mission.items import MAX_FILE_BYTES, Mission
from skyrange.codec.mission.qgc_plan import parse_plan
from skyrange.codec.mission.qgc_wpl import parse_waypoints
from skyrange.core.errors import InputError
from skyrange.core.files import read_input


def read_mission(path: str | os.PathLike[str]) -> Mission:
    """Read the mission in the file at `path`; `Mission.source` becomes the path's text.

    A file that begins with `QGC WPL` or `{` is read as that format; otherwise the suffix (`.plan`, `.waypoints`,
    `.txt`) decides. Raises `InputError` with the file's name and every problem found: unreadable, over 16 MiB, not
    UTF-8, or not a mission.
    """
    file = Path(path)
    name = str(file)
    expected = "a mission file (.plan, .waypoints or .txt)"
    data = read_input(file, name, "path", max_bytes=MAX_FILE_BYTES, expected=expected)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError.one(
            name, f"line {line}", f"byte 0x{data[error.start]:02x} at offset {error.start}", "UTF-8 text"
        ) from error
    start = text.lstrip()[:7]
    if start == "QGC WPL":
        return parse_waypoints(text, name)
    if start.startswith("{") or file.suffix.lower() == ".plan":
        return parse_plan(text, name)
    if file.suffix.lower() in (".waypoints", ".txt"):
        return parse_waypoints(text, name)
    raise InputError.one(
        name, "line 1", "another text", "`QGC WPL 110` or a JSON object", "Known: .plan, .waypoints and .txt files."
    )
