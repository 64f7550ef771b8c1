"""Missions of autopilots, from the frames of their uploads, as CMD messages of a DataFlash log.

An autopilot takes an item if it is the one that it waits for, and acknowledges the whole (libraries/GCS_MAVLink/
MissionItemProtocol.cpp): so the mission of a log is what the autopilot stored, also if somebody altered it on the way.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.message_columns import MessageGroup
from skyrange.codec.mission.items import GLOBAL_FRAMES
from skyrange.export.dataflash_rows import Rows, make_rows
from skyrange.record.read.station_frames import StationFrames

_MISSION: Final = dialect.MAV_MISSION_TYPE_MISSION
_PARTS: Final = (
    dialect.MAVLINK_MSG_ID_MISSION_COUNT,
    dialect.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST,
    dialect.MAVLINK_MSG_ID_MISSION_ITEM,
    dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT,
)
_E7: Final = 1e7


class MissionFrame(NamedTuple):
    """A frame of an upload, or the answer to its end."""

    time_ns: int
    vehicle: int
    message_id: int
    peer: tuple[int, int]
    """System and component of the ground station."""
    values: Any


def list_mission_frames(block: StationFrames, vehicle: Any, systems: dict[int, set[int]]) -> Iterator[MissionFrame]:
    """The frames of uploads to the autopilots of some aircraft, and their acknowledgements, in no order.

    `vehicle` has the number of each row's aircraft, `systems` the MAVLink system ids that each has had.
    """
    for group in block.groups(~block.received):
        if group.message_id in _PARTS:
            for frame in _frames(block, vehicle, group):
                if int(frame.values["target_system"]) in (0, *systems[frame.vehicle]):
                    yield frame
    for group in block.groups(block.received):
        if group.message_id == dialect.MAVLINK_MSG_ID_MISSION_ACK:
            for frame in _frames(block, vehicle, group):
                peer = int(frame.values["target_system"]), int(frame.values["target_component"])
                if frame.values["type"] == dialect.MAV_MISSION_ACCEPTED:
                    yield frame._replace(peer=peer)


def _frames(block: StationFrames, vehicle: Any, group: MessageGroup) -> Iterator[MissionFrame]:
    for place, row in enumerate(group.rows.tolist()):
        values = group.values[place]
        if values["mission_type"] == _MISSION:
            peer = int(group.systems[place]), int(group.components[place])
            yield MissionFrame(int(block.time_ns[row]), int(vehicle[row]), group.message_id, peer, values)


class StoredMission:
    """The mission of one autopilot, as its uploads tell."""

    def __init__(self) -> None:
        self._items: list[dict[str, float]] | None = []
        """None while it is not known."""
        self._peer: tuple[int, int] | None = None
        self._next = self._end = 0
        self._upload: list[dict[str, float]] = []

    def take(self, frame: MissionFrame) -> None:
        """A frame of an upload, or the answer to its end."""
        values = frame.values
        if frame.message_id == dialect.MAVLINK_MSG_ID_MISSION_COUNT:
            self._begin(frame, 0, int(values["count"]), [])
        elif frame.message_id == dialect.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST:
            self._begin(frame, int(values["start_index"]), int(values["end_index"]) + 1, list(self._items or []))
        elif frame.message_id == dialect.MAVLINK_MSG_ID_MISSION_ACK:
            if frame.peer == self._peer and self._next >= self._end:
                self._items, self._peer = self._upload, None
        elif frame.peer == self._peer and int(values["seq"]) == self._next < self._end:
            self._upload[self._next : self._next + 1] = [_item(values)]
            self._next += 1

    def _begin(self, frame: MissionFrame, first: int, end: int, items: list[dict[str, float]]) -> None:
        if self._peer in (None, frame.peer) and first <= len(items):
            self._peer, self._next, self._end, self._upload = frame.peer, first, end, items

    def rows(self, vehicle: int, time_ns: int, count: int) -> Rows | None:
        """CMD for each item, when the autopilot has stored `count` of them; None if the frames do not have these."""
        whole = self._upload if self._peer is not None and self._next >= self._end else self._items
        if whole is None or len(whole) != count:
            self._items = None
            return None
        self._items = whole
        columns = {name: np.array([item[name] for item in whole]) for name in (whole[0] if whole else ())}
        return make_rows(
            "CMD", np.full(count, vehicle), np.full(count, time_ns), CTot=count, CNum=np.arange(count), **columns
        )


def _item(values: Any) -> dict[str, float]:
    """The fields of CMD of a MISSION_ITEM or MISSION_ITEM_INT."""
    x, y = float(values["x"]), float(values["y"])
    if values["x"].dtype.kind == "f":
        is_global = int(values["frame"]) in GLOBAL_FRAMES
        x, y = (round(x * _E7), round(y * _E7)) if is_global else (round(x * 1e4), round(y * 1e4))
    params = {f"Prm{number}": float(values[f"param{number}"]) for number in range(1, 5)}
    place = {"Lat": x, "Lng": y, "Alt": float(values["z"]), "Frame": int(values["frame"])}
    return {"CId": int(values["command"]), **params, **place}
