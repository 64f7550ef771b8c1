"""Missions from the messages of their uploads and downloads."""

from __future__ import annotations

from collections.abc import Sequence

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyrange.codec.mission import Mission, MissionItem
from skyrange.codec.mission.items import GLOBAL_FRAMES
from skyrange.flightlog.model import SentMission

_DEGREES = 1e-7
_LOCAL_M = 1e-4  # MISSION_ITEM_INT: local x and y
MAX_ITEMS = 65_535


class MissionTransfer:
    """Collects the items of one transfer after another, until all that were announced are there.

    ArduPilot's item 0 is home. PX4 has no such item, and its first item is number 0 (`has_home` is false).
    """

    def __init__(self, source: str, *, has_home: bool) -> None:
        self._source = source
        self._has_home = has_home
        self._count = 0
        self._items: dict[int, MissionItem] = {}
        self.missions: list[SentMission] = []

    @property
    def missing(self) -> int:
        """How many items of the last transfer are missing."""
        return self._count - len(self._items)

    def begin(self, count: int) -> None:
        """A transfer of `count` items begins. Counts that are sent again for the same transfer do not matter."""
        if count != self._count or not self.missing:
            self._count, self._items = min(count, MAX_ITEMS), {}

    def add(self, time_s: float, number: int, item: MissionItem) -> None:
        """An item arrives."""
        if not self.missing or number >= self._count:
            return
        self._items[number] = item
        if self.missing:
            return
        mission = make_mission([self._items[k] for k in range(self._count)], self._source, has_home=self._has_home)
        if not self.missions or self.missions[-1].mission != mission:
            self.missions.append(SentMission(time_s, mission))


def make_mission(items: Sequence[MissionItem], source: str, *, has_home: bool) -> Mission:
    """The mission of items in order."""
    if not has_home:
        return Mission(tuple(items), source=source)
    home = (items[0].x, items[0].y, items[0].z) if items and (items[0].x or items[0].y) else None
    return Mission(tuple(items[1:]), home, source=source)


def item_of(message: dialect.MAVLink_message) -> MissionItem:
    """The item of a MISSION_ITEM or MISSION_ITEM_INT."""
    x, y = float(message.x), float(message.y)
    if message.get_type() == "MISSION_ITEM_INT":
        scale = _DEGREES if message.frame in GLOBAL_FRAMES else _LOCAL_M
        x, y = x * scale, y * scale
    values = (message.param1, message.param2, message.param3, message.param4)
    return MissionItem(message.frame, message.command, *values, x, y, message.z, bool(message.autocontinue))
