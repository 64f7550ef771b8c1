"""QGroundControl `.plan` files: reading and writing.

The format of https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html: JSON; an item is simple
(one MAVLink item, `null` for NaN) or complex. A complex item is read through the simple items that QGroundControl
embeds in it (`TransectStyleComplexItem.Items`: survey, corridor scan; or `Items`). Complex items saved as parameters
alone (structure scan, landing patterns, surveys of old versions) would need QGroundControl's own geometry and are
refused with that explanation.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NoReturn, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyrange.codec.mission.fence_and_rally import format_fence, format_rally, parse_fence, parse_rally
from skyrange.codec.mission.ignored_keys import PATTERN, Ignored, ReadObject, list_unread
from skyrange.codec.mission.items import (
    FRAMES,
    HOME_EXPECTED,
    MAX_ITEMS,
    Mission,
    MissionItem,
    ProblemCollector,
    check_item,
    expected_frames,
    is_valid_home,
    quote_value,
)
from skyrange.core.errors import InputError

MAX_DEPTH = 32
"""Nesting of brackets; QGroundControl's own plans need 7."""
DEFAULT_SETTINGS: dict[str, object] = {
    "cruiseSpeed": 15,
    "firmwareType": dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
    "globalPlanAltitudeMode": 1,
    "hoverSpeed": 5,
    "vehicleType": dialect.MAV_TYPE_QUADROTOR,
}
"""Settings of a plan whose mission came from another format (speeds in m/s, from the format's page)."""
_MULTIROTORS = frozenset(
    {
        dialect.MAV_TYPE_GENERIC, dialect.MAV_TYPE_QUADROTOR, dialect.MAV_TYPE_HEXAROTOR, dialect.MAV_TYPE_OCTOROTOR,
        dialect.MAV_TYPE_TRICOPTER, dialect.MAV_TYPE_COAXIAL, dialect.MAV_TYPE_HELICOPTER, dialect.MAV_TYPE_DODECAROTOR,
        dialect.MAV_TYPE_DECAROTOR,
    }
)  # fmt: skip
"""Types of aircraft that ArduCopter flies, and the type of a plan for any aircraft."""
_FIRMWARES = frozenset({dialect.MAV_AUTOPILOT_GENERIC, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA})
_OWN_KEYS = frozenset({"items", "plannedHomePosition", "version"})


def parse_plan(text: str, name: str) -> Mission:
    """Parse the mission in `text`; `name` is the file's name in errors.

    DO_JUMP's `doJumpId` references become sequence numbers. Raises `InputError` with the JSON path, value and
    expectation of everything wrong.
    """
    plan = _load(text, name)
    problems = ProblemCollector(name)
    if plan.get("fileType") != "Plan":
        problems.stop("fileType", "another" if "fileType" in plan else "missing", "'Plan'")
    if plan.get("version") != 1:
        problems.add("version", plan.get("version", "missing"), "1")
    fence = _optional_object(plan, "geoFence", problems)
    rally = _optional_object(plan, "rallyPoints", problems)
    mission = plan.get("mission")
    if not isinstance(mission, ReadObject):
        problems.stop("mission", "missing" if mission is None else mission, "an object")
    if mission.get("version") != 2:
        problems.add("mission.version", mission.get("version", "missing"), "2")
    home = _home(mission.get("plannedHomePosition"), problems)
    items = _ItemReader(problems)
    items.read(mission.get("items", "missing"))
    fence_items, rally_items = parse_fence(fence, problems), parse_rally(rally, problems)
    problems.raise_if_any()
    ignored = [*_check_vehicle(mission), *list_unread(plan)]
    return Mission(
        items=tuple(items.done),
        home=home,
        fence=fence_items,
        rally=rally_items,
        source=name,
        settings={key: value for key, value in mission.items() if key not in _OWN_KEYS},
        ignored=tuple(ignored),
    )


def _check_vehicle(mission: ReadObject) -> Iterator[Ignored]:
    """What the plan says of the aircraft that it was drawn for, if that is another kind than those that fly here."""
    for key, entry, flown, here in (
        ("vehicleType", "MAV_TYPE", _MULTIROTORS, "multirotors fly here"),
        ("firmwareType", "MAV_AUTOPILOT", _FIRMWARES, "ArduPilot's meaning of items counts here"),
    ):
        value = mission.get(key)
        number = _number(value)
        if value is not None and number not in flown:
            known = dialect.enums[entry].get(int(number)) if number is not None and number.is_integer() else None
            name = known.name if known is not None else quote_value(value)
            yield Ignored(f"mission.{key}", 1, f"the plan is for {name}; {here}", harmless=False)


def format_plan(mission: Mission) -> str:
    """Format `mission` as a plan that QGroundControl and `parse_plan` read; complex items are written as simple ones.

    Fence, rally points and settings are kept; a mission without settings gets `DEFAULT_SETTINGS`. QGroundControl
    requires a home position: raises `InputError` if `mission.home` is `None`.
    """
    if mission.home is None:
        raise InputError.one(
            mission.source or "mission",
            "home",
            "none",
            "a home position, which a plan must name",
            "Give the mission one.",
        )
    document = {
        "fileType": "Plan",
        "geoFence": format_fence(mission.fence),
        "groundStation": "skyrange",
        "mission": {
            **(DEFAULT_SETTINGS if mission.settings is None else mission.settings),
            "items": [_simple(sequence, item) for sequence, item in enumerate(mission.items, start=1)],
            "plannedHomePosition": list(mission.home),
            "version": 2,
        },
        "rallyPoints": format_rally(mission.rally),
        "version": 1,
    }
    return json.dumps(document, indent=4, allow_nan=False) + "\n"


def _simple(sequence: int, item: MissionItem) -> dict[str, object]:
    return {
        "autoContinue": item.autocontinue,
        "command": item.command,
        "doJumpId": sequence,  # so that DO_JUMP's sequence numbers are their own references
        "frame": item.frame,
        "params": [None if math.isnan(value) else value for value in item.values],
        "type": "SimpleItem",
    }


class _ItemReader:
    """Reads `mission.items` into a flat list, then resolves the targets of jumps."""

    def __init__(self, problems: ProblemCollector) -> None:
        self.problems = problems
        self.done: list[MissionItem] = []
        self._targets: dict[int, list[int]] = {}
        self._embedded_targets: dict[int, list[int]] = {}
        self._jumps: list[tuple[int, str]] = []

    def read(self, entries: object) -> None:
        if not isinstance(entries, list):
            self.problems.add("mission.items", entries, "a list")
            return
        for index, entry in enumerate(entries):
            where = f"mission.items[{index}]"
            kind = entry.get("type") if isinstance(entry, dict) else None
            if kind == "SimpleItem":
                self._simple_item(entry, where, self._targets)
            elif kind == "ComplexItem":
                self._complex_item(entry, where)
            elif isinstance(entry, dict):
                self.problems.add(f"{where}.type", entry.get("type", "missing"), "'SimpleItem' or 'ComplexItem'")
            else:
                self.problems.add(where, entry, "an object")
            if len(self.done) > MAX_ITEMS:
                self.problems.add(where, f"more than {MAX_ITEMS} items so far", f"at most {MAX_ITEMS}")
                return
        if not self.problems.total:
            self._resolve_jumps()

    def _complex_item(self, entry: ReadObject, where: str) -> None:
        transects = entry.get("TransectStyleComplexItem")
        holder, path = (transects, f"{where}.TransectStyleComplexItem") if transects is not None else (entry, where)
        embedded = holder.get("Items") if isinstance(holder, dict) else None
        if not isinstance(embedded, list) or not embedded:
            kind = quote_value(entry.get("complexItemType", "unnamed"))
            self.problems.add(
                f"{path}.Items",
                embedded if embedded else f"none in this {kind} item",
                "a list of embedded mission items",
                "QGroundControl embeds them in surveys and corridor scans; replace other patterns by waypoints.",
            )
            return
        for pattern in (entry, holder):
            if isinstance(pattern, ReadObject):
                pattern.reason = PATTERN
        for index, item in enumerate(embedded):
            if not isinstance(item, dict) or item.get("type") != "SimpleItem":
                self.problems.add(f"{path}.Items[{index}]", item, "a SimpleItem object")
            else:
                self._simple_item(item, f"{path}.Items[{index}]", self._embedded_targets)

    def _simple_item(self, entry: dict[str, object], where: str, targets: dict[int, list[int]]) -> None:
        problems = self.problems
        before = problems.total
        frame = _integer(entry, "frame", where, 255, problems)
        command = _integer(entry, "command", where, 65_535, problems)
        if frame is not None and frame not in FRAMES:
            problems.add(f"{where}.frame", frame, expected_frames())
        go_on = entry.get("autoContinue", "missing")
        if not isinstance(go_on, bool):
            problems.add(f"{where}.autoContinue", go_on, "true or false")
        jump_id = _integer(entry, "doJumpId", where, 2**31 - 1, problems) if "doJumpId" in entry else None
        values = _values(entry.get("params", "missing"), f"{where}.params", problems)
        if problems.total > before or frame is None or command is None:
            return
        positions = [f"{where}.params[{place}]" for place in range(7)]
        item = check_item(frame, command, values, positions, problems, autocontinue=go_on is True)
        if item is None:
            return
        self.done.append(item)
        if jump_id is not None:
            targets.setdefault(jump_id, []).append(len(self.done))
        if command == dialect.MAV_CMD_DO_JUMP:
            self._jumps.append((len(self.done) - 1, f"{where}.params[0]"))

    def _resolve_jumps(self) -> None:
        """Resolve as QGroundControl does: a DO_JUMP names the doJumpId of an item; top-level items precede embedded
        ones.
        """
        for index, where in self._jumps:
            item = self.done[index]
            wanted = int(item.param1) if item.param1.is_integer() else None
            places = self._targets.get(wanted) or self._embedded_targets.get(wanted) if wanted is not None else None
            if places is None:
                self.problems.add(where, item.param1, "the doJumpId of an item")
            elif len(places) > 1:
                self.problems.add(where, item.param1, f"a doJumpId of one item alone, {len(places)} have this one")
            else:
                self.done[index] = replace(item, param1=float(places[0]))


def _load(text: str, name: str) -> ReadObject:
    """The JSON object in `text`: nested no deeper than `MAX_DEPTH`, all numbers finite."""
    try:
        document = json.loads(text, parse_constant=_refuse_constant, object_hook=ReadObject)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno} column {error.colno}"
        # not quoted: the file may be none of this user's, named by a scenario of somebody else
        raise InputError.one(name, where, error.msg, "JSON") from None
    except RecursionError:
        raise InputError.one(name, "file", "brackets nested too deeply", f"at most {MAX_DEPTH} levels") from None
    except ValueError as error:  # a constant JSON does not know, an integer of thousands of digits
        raise InputError.one(name, "file", str(error), "JSON with finite numbers, null for none") from error
    if not isinstance(document, ReadObject):
        raise InputError.one(name, "file", f"a JSON {type(document).__name__}", "a JSON object with fileType 'Plan'")
    problems = ProblemCollector(name)
    for link, value, depth in _walk(document):
        if depth > MAX_DEPTH:
            problems.stop(_path(link)[:60], f"more than {MAX_DEPTH} levels deep", f"at most {MAX_DEPTH} levels")
        if isinstance(value, float) and not math.isfinite(value):
            problems.add(_path(link), value, "a finite number")
    problems.raise_if_any()
    return document


_Link: TypeAlias = "tuple[_Link, str | int] | None"
"""The position of a value: its parent's link and its key there. Formatted only for errors, since keys may be huge."""


def _walk(document: dict[str, object]) -> Iterator[tuple[_Link, object, int]]:
    """Every value with its position and depth, parents first; the caller bounds the depth."""
    stack: list[tuple[_Link, object, int]] = [(None, document, 0)]
    while stack:
        link, value, depth = stack.pop()
        yield link, value, depth
        if isinstance(value, dict):
            stack.extend(((link, key), child, depth + 1) for key, child in value.items())
        elif isinstance(value, list):
            stack.extend(((link, place), child, depth + 1) for place, child in enumerate(value))


def _path(link: _Link) -> str:
    """Text of a position such as `geoFence.polygons[0]`, with keys cut at 40 characters."""
    steps = []
    while link is not None:
        link, key = link
        steps.append(f"[{key}]" if isinstance(key, int) else f".{ascii(key[:40])[1:-1]}")
    return "".join(reversed(steps)).lstrip(".")


def _refuse_constant(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a JSON number")


def _optional_object(plan: ReadObject, key: str, problems: ProblemCollector) -> ReadObject | None:
    value = plan.get(key)
    if value is None or isinstance(value, ReadObject):
        return value
    problems.add(key, value, "an object")
    return None


def _home(value: object, problems: ProblemCollector) -> tuple[float, float, float] | None:
    """The planned home. A plan without one is accepted, although QGroundControl would refuse it."""
    if value is None:
        return None
    where = "mission.plannedHomePosition"
    numbers = [_number(entry) for entry in value] if isinstance(value, list) else []
    if len(numbers) != 3 or None in numbers:
        problems.add(where, value, f"three numbers: {HOME_EXPECTED}")
        return None
    lat, lon, alt = (float(number or 0.0) for number in numbers)
    if not is_valid_home(lat, lon, alt):
        problems.add(where, value, HOME_EXPECTED)
    return lat, lon, alt


def _values(params: object, where: str, problems: ProblemCollector) -> list[float]:
    """The seven numbers of an item, NaN for null."""
    if not isinstance(params, list) or len(params) != 7:
        problems.add(where, params, "a list of 7 numbers or nulls")
        return []
    values = []
    for place, entry in enumerate(params):
        number = math.nan if entry is None else _number(entry)
        if number is None:
            problems.add(f"{where}[{place}]", entry, "a number or null")
        else:
            values.append(number)
    return values


def _number(value: object) -> float | None:
    """A JSON number as a float; `None` for anything else and for numbers beyond the range of a float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return None


def _integer(entry: dict[str, object], key: str, where: str, highest: int, problems: ProblemCollector) -> int | None:
    """An integer in 0…highest (JSON may write it 16.0); otherwise adds a problem and returns `None`."""
    number = _number(entry.get(key))
    if number is None or not number.is_integer() or not 0 <= number <= highest:
        problems.add(f"{where}.{key}", entry.get(key, "missing"), f"a whole number in 0…{highest}")
        return None
    return int(number)
