"""Mission read-back in flight: missions are read back at intervals and compared with what the station has sent.

A ground station reads a mission back once, after its upload. This goes on doing it while the aircraft flies, as a
component of its own in the station's system, and takes the answers off the link, so the station never sees them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.orders import read
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission.differences import describe_difference
from skyrange.defence.bases.link_ends import AUTOPILOT

_TIMEOUT_NS: Final = 1_500 * sky.NS_PER_MS
"""https://mavlink.io/en/services/mission.html, "Timeouts and retries": default, and number of retries."""
_RETRIES: Final = 5
_UNANSWERED: Final = 2
"""Read-backs in a row without any answer that raise an alarm: one may fall into a burst of losses."""
_KIND: Final = int(mav.MAV_MISSION_TYPE_MISSION)
_ANSWERS: Final = frozenset((
    mav.MAVLINK_MSG_ID_MISSION_COUNT, mav.MAVLINK_MSG_ID_MISSION_ITEM_INT, mav.MAVLINK_MSG_ID_MISSION_ACK,
    mav.MAVLINK_MSG_ID_MISSION_REQUEST, mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
))  # fmt: skip
_REQUESTS: Final = frozenset((
    mav.MAVLINK_MSG_ID_MISSION_REQUEST_LIST, mav.MAVLINK_MSG_ID_MISSION_REQUEST_INT, mav.MAVLINK_MSG_ID_MISSION_ACK,
))  # fmt: skip
_COMMANDS: Final = {"rtl": mav.MAV_CMD_NAV_RETURN_TO_LAUNCH, "land": mav.MAV_CMD_NAV_LAND}


@dataclass(slots=True)
class Sent:
    """The mission that the station has sent."""

    count: int = -1
    """-1 until one was uploaded."""
    items: dict[int, sky.MavlinkMessage] = field(default_factory=dict)
    accepted: bool = False

    @property
    def complete(self) -> bool:
        """Whether all its items were sent."""
        return self.count >= 0 and all(seq in self.items for seq in range(self.count))


@sky.defence(
    "mission.read_back",
    surface=("gcs",),
    place="the station's end of the gcs link; knows the uploads that leave, and the answers that arrive",
    effect="commands an aircraft whose mission differs to return or to land",
    alerts=("mission.differs", "mission.unanswered"),
    against=("mavlink.mission_replace", "mavlink.mission_clear"),
    evasion="alters the items that are read back too, as mavlink.mission_alter does, or starts and ends between two "
    "read-backs",
    cost="a request and an answer for each item of the mission, every `every_s`",
    nominal=("inject", "drop"),
    realism={
        "the reading component": "assumed: a program beside the ground station, on its computer",
        "the protocol and what an autopilot stores": "cited: mavlink.io, mission protocol; AP_Mission.cpp",
    },
)
class MissionReadBack(sky.SpeakingTap):
    """Reads missions back in flight at intervals and compares them with what the station has sent."""

    component: ClassVar = int(mav.MAV_COMP_ID_USER1)
    decides: ClassVar = "mission read-back"

    every_s: sky.Number = sky.param(
        "Time in seconds from the end of one read-back to the begin of the next; at a cruise of 5 m/s the default is "
        "50 m of flight.",
        default=10.0, ge=1, le=3600,
    )  # fmt: skip
    action: Literal["rtl", "land", "alarm"] = sky.param(
        "What an armed aircraft is commanded when its mission differs: rtl (NAV_RETURN_TO_LAUNCH), land (NAV_LAND), or "
        "nothing but an alarm.",
        default="rtl",
    )
    sent: Sent = sky.state(Sent)
    due: sky.Time | None = None
    """When the next read-back begins, or the last request is sent again."""
    asked: int = -2
    """The item that was asked for; -1 the count; -2 while nothing is."""
    retries: int = 0
    unanswered: int = 0
    """Read-backs in a row of which a request had no answer, and none came since."""

    @staticmethod
    def inspects(frame: sky.Frame) -> bool:
        """Whether a frame is of a transfer of a mission towards the station."""
        return frame.direction == "rev" and sky.message_id(frame.payload) in _ANSWERS

    def find_end(self) -> tuple[str, str]:
        """See `EndTap`."""
        return "gcs", "gcs"

    def find_rules(self, end: sky.PathEnd) -> Sequence[sky.PathRule]:
        """What it sends."""
        command = _COMMANDS.get(self.action)
        if command is None:
            return [sky.Sends(end, "fwd", _REQUESTS)]
        return [sky.Sends(end, "fwd", _REQUESTS | {mav.MAVLINK_MSG_ID_COMMAND_LONG}, frozenset((int(command),)))]

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> Sequence[sky.Verdict]:
        """Learn what the station uploads and whether the aircraft is armed; take the own answers off the link."""
        number = sky.message_id(frame.payload)
        if frame.direction == "rev":
            if number == mav.MAVLINK_MSG_ID_HEARTBEAT:
                self.learn_armed(frame.payload)
                return ()
            return self._hear(now, frame.payload) if number in _ANSWERS else ()
        if number in (mav.MAVLINK_MSG_ID_MISSION_COUNT, mav.MAVLINK_MSG_ID_MISSION_ITEM_INT):
            self._learn_mission(frame.payload)
        return ()

    def next_wakeup(self) -> sky.Time | None:
        """When a read-back begins or a request is repeated."""
        return self.due

    def on_wakeup(self, now: sky.Time) -> Sequence[sky.Verdict]:
        """Ask for the count, or again for what has not come."""
        if self.due is None or now < self.due:
            return ()
        if now < self.schedule.start_ns:
            self.due = now + sky.from_seconds(self.every_s)
            return ()
        if self.asked == -2:
            self.retries = 0
            return self._ask(now, -1)
        self.retries += 1
        if self.retries > _RETRIES:
            self._end(now)
            self.unanswered += 1
            if self.unanswered < _UNANSWERED:
                return ()
            return self.alarm.raise_at(now, "mission.unanswered", 0.5)
        return self._ask(now, self.asked)

    def _learn_mission(self, payload: bytes) -> None:
        message = read(payload)
        if message is None or message.mission_type != _KIND:
            return
        if message.get_msgId() == mav.MAVLINK_MSG_ID_MISSION_COUNT:
            self.sent = Sent(message.count)
            self.asked, self.due = -2, None
        else:
            self.sent.items[message.seq] = message

    def _hear(self, now: sky.Time, payload: bytes) -> Sequence[sky.Verdict]:
        message = read(payload)
        if message is None or message.target_system != self.packer.system or message.mission_type != _KIND:
            return ()
        number = message.get_msgId()
        if message.target_component != self.component:
            done = number == mav.MAVLINK_MSG_ID_MISSION_ACK and message.type == mav.MAV_MISSION_ACCEPTED
            if done and not self.sent.accepted and self.sent.complete:
                self.sent.accepted = True
                self.asked, self.due = -2, now + sky.from_seconds(self.every_s)
            return ()
        return [sky.Drop(), *self._compare(now, message, number)]

    def _compare(self, now: sky.Time, message: sky.MavlinkMessage, number: int) -> Sequence[sky.Verdict]:
        self.unanswered = 0
        if self.asked >= -1 and number == mav.MAVLINK_MSG_ID_MISSION_COUNT:
            # it comes for an item too that the mission no longer has (MissionItemProtocol.cpp, handle_mission_request)
            if message.count != self.sent.count:
                return self._differ(now, f"{message.count} items, sent {self.sent.count}")
            return self._next(now, 1) if self.asked == -1 else ()  # item 0 is the autopilot's own home
        if number == mav.MAVLINK_MSG_ID_MISSION_ACK and message.type == mav.MAV_MISSION_DENIED and self.asked >= -1:
            # what an autopilot answers while somebody uploads: there is no read-back while the station does
            return self._differ(now, "an upload that is not the station's")
        if number != mav.MAVLINK_MSG_ID_MISSION_ITEM_INT or message.seq != self.asked:
            return ()
        problem = describe_difference(self.sent.items[message.seq], message)
        if problem:
            return self._differ(now, f"item {message.seq}: {problem}")
        return self._next(now, message.seq + 1)

    def _next(self, now: sky.Time, seq: int) -> Sequence[sky.Verdict]:
        """Ask for an item, or end the read-back after the last."""
        self.retries = 0
        if seq < self.sent.count:
            return self._ask(now, seq)
        self._end(now)
        ack = mav.MAVLink_mission_ack_message(self.system, AUTOPILOT, mav.MAV_MISSION_ACCEPTED, _KIND)
        return [self.say(ack)]

    def _differ(self, now: sky.Time, problem: str) -> Sequence[sky.Verdict]:
        self._end(now)
        command = _COMMANDS.get(self.action)
        answer = [self.command(command)] if self.armed and command is not None else []
        return [*answer, *self.alarm.raise_at(now, "mission.differs", 1.0, what=problem)]

    def _end(self, now: sky.Time) -> None:
        self.asked, self.due = -2, now + sky.from_seconds(self.every_s)

    def _ask(self, now: sky.Time, seq: int) -> list[sky.Verdict]:
        self.asked, self.due = seq, now + _TIMEOUT_NS
        if seq < 0:
            return [self.say(mav.MAVLink_mission_request_list_message(self.system, AUTOPILOT, _KIND))]
        return [self.say(mav.MAVLink_mission_request_int_message(self.system, AUTOPILOT, seq, _KIND))]
