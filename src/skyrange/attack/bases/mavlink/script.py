"""Base of kinds that inject a script: commands and uploads, one after another, each until it is acknowledged.

By https://mavlink.io/en/services/command.html and https://mavlink.io/en/services/mission.html: a command, or the count
of an upload, is sent again where no acknowledgement comes; items are sent on request.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

from skyrange.attack.bases.mavlink.injection import Injection
from skyrange.attack.bases.mavlink.orders import AUTOPILOT, Order
from skyrange.attack.contract import Place
from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import NS_PER_MS, Time

RETRY_NS: Final = 1_500 * NS_PER_MS
"""mavlink.io "Timeouts and retries": default."""
TRIES: Final = 6
"""The first try and five retries, as mavlink.io recommends."""
_ANSWER_NS: Final = NS_PER_MS
"""Time in which the node answers a request."""
_DOWNLOADS: Final = (mav.MAVLINK_MSG_ID_MISSION_ITEM_INT, mav.MAVLINK_MSG_ID_MISSION_COUNT)
"""Answers to what the sham requests."""
_REQUESTS: Final = (mav.MAVLINK_MSG_ID_MISSION_REQUEST, mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT)


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


class Script(Injection):
    """Takes the steps of `steps` in order, once, each until it is answered or was tried six times.

    In place of an upload the sham requests an item, and of a removal the number of items.
    """

    needs: ClassVar[tuple[str, ...]] = ("steps",)
    reads = (
        "MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK", "COMMAND_ACK", "MISSION_ITEM_INT", "MISSION_COUNT",
    )  # fmt: skip

    todo: tuple[Step, ...]
    done: int = 0
    """Steps that are answered, or were tried in vain."""
    tries: int = 0
    requested: int = -1
    """The number of the item that the aircraft asked for; -1 for none."""

    def steps(self) -> Sequence[Step]:
        """The steps."""
        raise NotImplementedError

    def begin(self) -> None:
        """See `LinkTap`."""
        super().begin()
        self.todo = tuple(self.steps())

    def period_ns(self) -> Time:
        """Time after which a step is tried again."""
        return RETRY_NS

    def next_wakeup(self) -> Time | None:
        """When it next sends."""
        return self.clock.due if self.done < len(self.todo) else None

    def on_message(self, now: Time, message: Message) -> None:
        """Go on where the aircraft answers; send the item that it asks for."""
        if not self.tries or self.done >= len(self.todo) or not self.claimed.is_answered(message):
            return
        step, number = self.todo[self.done], message.get_msgId()
        if isinstance(step, Order):
            command = mav.MAV_CMD_REQUEST_MESSAGE if self.sham else step.command
            answered = number == mav.MAVLINK_MSG_ID_COMMAND_ACK and message.command == command
            if answered and message.result != mav.MAV_RESULT_IN_PROGRESS:
                self._go_on(now)
            return
        if number == mav.MAVLINK_MSG_ID_COMMAND_ACK or message.mission_type != step.mission_type:
            return
        if number in _DOWNLOADS:
            if self.sham:
                self._go_on(now)
        elif number in _REQUESTS:
            if isinstance(step, Upload) and message.seq < len(step.items):
                self.requested = message.seq
                self.tries = 1
                self.clock.due = now + _ANSWER_NS
        elif self.sham or message.type != mav.MAV_MISSION_INVALID_SEQUENCE:
            self._go_on(now)

    def orders(self, now: Time) -> Sequence[Order | Message]:
        """The command, the count or the item that is due."""
        if self.tries >= TRIES and self.done < len(self.todo):
            self._go_on(now)
            self.clock.due = now + RETRY_NS
        if self.done >= len(self.todo):
            return []
        self.tries += 1
        return [self._message()]

    def _go_on(self, now: Time) -> None:
        self.done += 1
        self.tries = 0
        self.requested = -1
        self.clock.due = now + _ANSWER_NS

    def _message(self) -> Order | Message:
        step = self.todo[self.done]
        if isinstance(step, Order):
            return step
        if isinstance(step, Clear):
            return mav.MAVLink_mission_clear_all_message(self.target, AUTOPILOT, step.mission_type)
        if self.requested >= 0:
            return step.items[self.requested].message(self.target, AUTOPILOT, self.requested, step.mission_type)
        return mav.MAVLink_mission_count_message(self.target, AUTOPILOT, len(step.items), step.mission_type)
