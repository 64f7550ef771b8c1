"""Scripts: commands and uploads of missions, fences or rally points, one after another, each until it is acknowledged.

By https://mavlink.io/en/services/command.html and https://mavlink.io/en/services/mission.html: a command, or the count
of an upload, is sent again where no acknowledgement comes; items are sent on request.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from skyrange.attack.contract import Place
from skyrange.attack.mavlink.injection import Order, Sender, read
from skyrange.attack.on_path import Repetition
from skyrange.codec.mavlink import Message, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.core.time import NS_PER_MS, Time

RETRY_NS: Final = 1_500 * NS_PER_MS
"""mavlink.io "Timeouts and retries": default."""
TRIES: Final = 6
"""The first try and five retries, as mavlink.io recommends."""
_ANSWER_NS: Final = NS_PER_MS
"""Time in which the node answers a request."""
_REQUESTS: Final = (mav.MAVLINK_MSG_ID_MISSION_REQUEST, mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT)
_READ: Final = frozenset((*_REQUESTS, mav.MAVLINK_MSG_ID_MISSION_ACK, mav.MAVLINK_MSG_ID_COMMAND_ACK))


@dataclass(frozen=True, slots=True)
class Item:
    """An item of a mission, a fence or rally points; the place is in degrees and metres above sea level."""

    command: int
    place: Place
    param1: float = 0.0

    def message(self, system: int, component: int, seq: int, mission_type: int) -> Message:
        """MISSION_ITEM_INT of it."""
        lat, lon, alt_m = self.place
        return mav.MAVLink_mission_item_int_message(
            system, component, seq, mav.MAV_FRAME_GLOBAL, self.command, 0, 1, self.param1, 0.0, 0.0, 0.0,
            round(lat * 1e7), round(lon * 1e7), alt_m, mission_type,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Upload:
    """Items to upload, all of one type."""

    items: tuple[Item, ...]
    mission_type: int = mav.MAV_MISSION_TYPE_MISSION


@dataclass(frozen=True, slots=True)
class Clear:
    """MISSION_CLEAR_ALL of one type."""

    mission_type: int = mav.MAV_MISSION_TYPE_MISSION


Step = Order | Upload | Clear


@dataclass(slots=True)
class Script:
    """A source that takes steps in order, once, each until it is answered or was tried six times."""

    sender: Sender
    schedule: Schedule
    steps: tuple[Step, ...]
    at: int = 0
    tries: int = 0
    requested: int = -1
    """The number of the item that the aircraft asked for; -1 for none."""
    clock: Repetition = field(init=False)

    def __post_init__(self) -> None:
        self.clock = Repetition(self.schedule, RETRY_NS)

    @property
    def due(self) -> Time | None:
        """When it next sends."""
        return self.clock.due if self.at < len(self.steps) else None

    def see(self, now: Time, frame: Frame) -> None:
        """Learn who the station is, and what the aircraft answers."""
        self.sender.see(frame)
        if frame.direction != "rev" or message_id(frame.payload) not in _READ:
            return
        message = read(frame.payload)
        if message is None or not self.tries or self.at >= len(self.steps) or not self.sender.is_answered(message):
            return
        step, number = self.steps[self.at], message.get_msgId()
        if isinstance(step, Order):
            answered = number == mav.MAVLINK_MSG_ID_COMMAND_ACK and message.command == step.command
            if answered and message.result != mav.MAV_RESULT_IN_PROGRESS:
                self._go_on(now)
            return
        if number == mav.MAVLINK_MSG_ID_COMMAND_ACK or message.mission_type != step.mission_type:
            return
        if number in _REQUESTS:
            if isinstance(step, Upload) and message.seq < len(step.items):
                self.requested = message.seq
                self.tries = 1
                self.clock.due = now + _ANSWER_NS
        elif message.type != mav.MAV_MISSION_INVALID_SEQUENCE:
            self._go_on(now)

    def make(self, now: Time) -> Sequence[tuple[Literal["fwd"], bytes]]:
        """The command, the count or the item that is due."""
        if self.at >= len(self.steps) or not self.clock.take(now):
            return []
        if self.tries >= TRIES:
            self._go_on(now)
            if self.at >= len(self.steps):
                return []
            self.clock.due = now + RETRY_NS
        self.tries += 1
        return [("fwd", self.sender.pack(self._message()))]

    def _go_on(self, now: Time) -> None:
        self.at += 1
        self.tries = 0
        self.requested = -1
        self.clock.due = now + _ANSWER_NS

    def _message(self) -> Message:
        step, system, component = self.steps[self.at], self.sender.target, self.sender.component
        if isinstance(step, Order):
            return step.message(system, component)
        if isinstance(step, Clear):
            return mav.MAVLink_mission_clear_all_message(system, component, step.mission_type)
        if self.requested >= 0:
            return step.items[self.requested].message(system, component, self.requested, step.mission_type)
        return mav.MAVLink_mission_count_message(system, component, len(step.items), step.mission_type)
