"""Upload and read-back of missions, fences and rally points: the MAVLink mission protocol, ground station side.

By https://mavlink.io/en/services/mission.html, with its default timeouts: upload (MISSION_COUNT, items on request,
MISSION_ACK) and download (MISSION_REQUEST_LIST, items on request, MISSION_ACK). Four additions make transfers
robust on links that lose, duplicate and reorder frames. Every request for an item in range is answered, in any
order and any number of times. INVALID_SEQUENCE, ArduPilot's answer to an item that arrived twice, is not a failure.
ACCEPTED counts only after the last item was requested, so that an old acknowledgement is not mistaken for the
current one. A temporary rejection (ERROR, DENIED while another transfer runs, OPERATION_CANCELLED) restarts the
transfer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import MissionItem
from skyrange.codec.mission.differences import AREAS, GLOBAL_FRAMES, LOCATED, describe_difference
from skyrange.core.time import NEVER, NS_PER_MS, Time
from skyrange.gcs.plan.plans import FlightPlan
from skyrange.gcs.protocols.commands import enum_name


class MissionItemInt(NamedTuple):
    """A mission item with x and y as MISSION_ITEM_INT encodes them: 1e-7 degrees in global frames. No NaN."""

    frame: int
    command: int
    param1: float
    param2: float
    param3: float
    param4: float
    x: int
    y: int
    z: float
    autocontinue: int

    def message(self, seq: int, system: int, component: int, kind: int = mav.MAV_MISSION_TYPE_MISSION) -> Message:
        """The MISSION_ITEM_INT message that carries it as item number `seq` of a list of this MAV_MISSION_TYPE."""
        return mav.MAVLink_mission_item_int_message(
            system, component, seq, self.frame, self.command, 0, self.autocontinue,
            self.param1, self.param2, self.param3, self.param4, self.x, self.y, self.z, kind,
        )  # fmt: skip


class ItemList(NamedTuple):
    """What an autopilot stores as one list: the mission, the fence, or the rally points."""

    kind: int
    """MAV_MISSION_TYPE."""
    items: tuple[MissionItemInt, ...]


def encode_lists(plan: FlightPlan) -> list[ItemList]:
    """What is uploaded for a plan, in QGroundControl's order: its mission, its fence, its rally points."""
    lists = [ItemList(mav.MAV_MISSION_TYPE_MISSION, encode_mission(plan))] if plan.kind == "auto" else []
    for kind, items in ((mav.MAV_MISSION_TYPE_FENCE, plan.fence), (mav.MAV_MISSION_TYPE_RALLY, plan.rally)):
        if items:
            lists.append(ItemList(kind, tuple(map(_encode, items))))
    return lists


def encode_mission(plan: FlightPlan) -> tuple[MissionItemInt, ...]:
    """All items of an auto plan as they are uploaded; ArduPilot's item 0 (home) comes first."""
    lat, lon = plan.origin.geodetic_of(plan.home_enu_m.east_m, plan.home_enu_m.north_m)
    alt_m = plan.origin.alt_msl_m + plan.home_enu_m.up_m
    home = MissionItem(mav.MAV_FRAME_GLOBAL, mav.MAV_CMD_NAV_WAYPOINT, 0.0, 0.0, 0.0, 0.0, lat, lon, alt_m)
    return tuple(_encode(item) for item in (home, *plan.items))


def _encode(item: MissionItem) -> MissionItemInt:
    # An unset (NaN) parameter is sent as 0: ArduCopter rejects most NaN, and stores 0 for unset parameters.
    p1, p2, p3, p4 = (0.0 if math.isnan(value) else value for value in item.values[:4])
    scale = 1e7 if item.frame in GLOBAL_FRAMES and item.command in LOCATED | AREAS else 1.0
    x, y = round(item.x * scale), round(item.y * scale)
    return MissionItemInt(item.frame, item.command, p1, p2, p3, p4, x, y, item.z, int(item.autocontinue))


TIMEOUT_NS = 1_500 * NS_PER_MS
"""mavlink.io "Timeouts and retries": default."""
ITEM_TIMEOUT_NS = 250 * NS_PER_MS
"""mavlink.io "Timeouts and retries": mission items. The timeout doubles with each retry, up to `TIMEOUT_NS`: on a
link with a longer round trip, all retries at the initial rate would be used up before the first answer."""
MAX_RETRIES = 5
"""mavlink.io "Timeouts and retries": retries before cancelling."""
MAX_ATTEMPTS = 3
"""How often a whole transfer is started before it is given up."""

_TEMPORARY = frozenset({mav.MAV_MISSION_ERROR, mav.MAV_MISSION_DENIED, mav.MAV_MISSION_OPERATION_CANCELLED})
_MISSION = int(mav.MAV_MISSION_TYPE_MISSION)
LIST_NAMES = {
    _MISSION: "mission", int(mav.MAV_MISSION_TYPE_FENCE): "fence", int(mav.MAV_MISSION_TYPE_RALLY): "rally points"
}  # fmt: skip
"""What is transferred, by MAV_MISSION_TYPE, as the reason of a flight that fails names it."""


@dataclass(slots=True)
class Transfer:
    """State common to upload and download: the peer, the next deadline, and the result.

    `result` is empty during the transfer, `"done"` after success, else the reason for which it was given up.
    """

    items: tuple[MissionItemInt, ...]
    system: int
    component: int
    kind: int = _MISSION
    """MAV_MISSION_TYPE."""
    due: Time = NEVER
    retries: int = 0
    attempts: int = 0
    result: str = ""

    @property
    def homes(self) -> int:
        """How many items are not the plan's own: ArduPilot sets item 0 of a mission to its home, whatever was sent."""
        return 1 if self.kind == _MISSION else 0

    @property
    def name(self) -> str:
        """What is transferred."""
        return LIST_NAMES[self.kind]

    def begin(self, now: Time) -> list[Message]:
        """Start or restart the transfer; returns the messages to send."""
        self.attempts += 1
        self.retries = 0
        self.due = now + TIMEOUT_NS
        return [self._first_message()]

    def on_time(self, now: Time) -> list[Message]:
        """The messages to send at `due`: the last one again, or the first one if the transfer restarts."""
        if now < self.due or self.result:
            return []
        self.retries += 1
        if self.retries > MAX_RETRIES:
            return self._restart(now, "no answer")
        return self._repeat(now)

    def on_ack(self, now: Time, kind: int) -> None:
        """Handle a MISSION_ACK with result `kind` (MAV_MISSION_RESULT)."""
        raise NotImplementedError

    def _reject(self, now: Time, kind: int) -> None:
        """Handle a negative MISSION_ACK."""
        reason = enum_name("MAV_MISSION_RESULT", "MAV_MISSION_", kind)
        if kind in _TEMPORARY and self.attempts < MAX_ATTEMPTS:
            self.retries = MAX_RETRIES  # the next `on_time` restarts the transfer, once frames in flight have arrived
            self.due = now + TIMEOUT_NS
        else:
            self._end(f"{self._name()} refused{self._refused_item()}: {reason}")

    def _restart(self, now: Time, reason: str) -> list[Message]:
        if self.attempts < MAX_ATTEMPTS:
            return self.begin(now)
        self._end(f"{self._name()}: {reason} in {self.attempts} attempts")
        return []

    def _end(self, result: str) -> None:
        self.result = result
        self.due = NEVER

    def _refused_item(self) -> str:
        """Which item a rejection concerns, for its reason."""
        return ""

    def _name(self) -> str:
        raise NotImplementedError

    def _first_message(self) -> Message:
        raise NotImplementedError

    def _repeat(self, now: Time) -> list[Message]:
        raise NotImplementedError


@dataclass(slots=True)
class Upload(Transfer):
    """Upload of one list."""

    last_sent: int = -1
    complete: bool = False
    """Whether the last item was requested in this attempt."""

    def begin(self, now: Time) -> list[Message]:
        """Send MISSION_COUNT."""
        self.last_sent = -1
        self.complete = False
        return Transfer.begin(self, now)

    def on_request(self, now: Time, seq: int) -> list[Message]:
        """Answer a MISSION_REQUEST_INT or MISSION_REQUEST for item `seq` with the item, if it exists.

        Late requests are answered even after the transfer has ended.
        """
        if seq >= len(self.items):
            return []
        if not self.result:
            self.last_sent = seq
            self.complete = self.complete or seq == len(self.items) - 1
            self.retries = 0
            self.due = now + TIMEOUT_NS
        return [self.items[seq].message(seq, self.system, self.component, self.kind)]

    def on_ack(self, now: Time, kind: int) -> None:
        """Handle a MISSION_ACK."""
        if self.result or kind == mav.MAV_MISSION_INVALID_SEQUENCE:
            return
        if kind == mav.MAV_MISSION_ACCEPTED:
            if self.complete:
                self._end("done")
        else:
            self._reject(now, kind)

    def _refused_item(self) -> str:
        if self.last_sent < self.homes:
            return ""
        return f" at item {self.last_sent} (command {self.items[self.last_sent].command})"

    def _name(self) -> str:
        return f"{self.name} upload"

    def _first_message(self) -> Message:
        return mav.MAVLink_mission_count_message(self.system, self.component, len(self.items), self.kind)

    def _repeat(self, now: Time) -> list[Message]:
        self.due = now + TIMEOUT_NS
        if self.last_sent < 0:
            return [self._first_message()]
        return [self.items[self.last_sent].message(self.last_sent, self.system, self.component, self.kind)]


@dataclass(slots=True)
class Download(Transfer):
    """Read-back, compared item by item with what was sent."""

    requested: int = -1
    """The number of the requested item; -1 while MISSION_COUNT is awaited."""

    def begin(self, now: Time) -> list[Message]:
        """Send MISSION_REQUEST_LIST."""
        self.requested = -1
        return Transfer.begin(self, now)

    def on_count(self, now: Time, count: int) -> list[Message]:
        """Handle a MISSION_COUNT: request the first item, or end the transfer if the number is wrong."""
        if self.result or self.requested >= 0:
            return []
        if count != len(self.items):
            self._end(f"{self._name()} differs: {count} items, sent {len(self.items)}")
            return [self._ack_message(mav.MAV_MISSION_OPERATION_CANCELLED)]
        return self._request(now, 0)

    def on_item(self, now: Time, item: Message) -> list[Message]:
        """Handle a MISSION_ITEM_INT: request the next item, or finish. Items that were not requested are ignored."""
        if self.result or item.seq != self.requested:
            return []
        problem = describe_difference(self.items[item.seq], item) if item.seq >= self.homes else ""
        if problem:
            self._end(f"{self._name()} differs at item {item.seq}: {problem}")
            return [self._ack_message(mav.MAV_MISSION_OPERATION_CANCELLED)]
        if item.seq == len(self.items) - 1:
            self._end("done")
            return [self._ack_message(mav.MAV_MISSION_ACCEPTED)]
        return self._request(now, item.seq + 1)

    def on_ack(self, now: Time, kind: int) -> None:
        """Handle a MISSION_ACK; only a rejection has a meaning during a download."""
        if not self.result and kind not in (mav.MAV_MISSION_ACCEPTED, mav.MAV_MISSION_INVALID_SEQUENCE):
            self._reject(now, kind)

    def _request(self, now: Time, seq: int) -> list[Message]:
        self.requested = seq
        self.retries = 0
        self.due = now + ITEM_TIMEOUT_NS
        return [self._request_message()]

    def _request_message(self) -> Message:
        return mav.MAVLink_mission_request_int_message(self.system, self.component, self.requested, self.kind)

    def _ack_message(self, kind: int) -> Message:
        return mav.MAVLink_mission_ack_message(self.system, self.component, kind, self.kind)

    def _name(self) -> str:
        return f"{self.name} read-back"

    def _first_message(self) -> Message:
        return mav.MAVLink_mission_request_list_message(self.system, self.component, self.kind)

    def _repeat(self, now: Time) -> list[Message]:
        if self.requested < 0:
            self.due = now + TIMEOUT_NS
            return [self._first_message()]
        self.due = now + min(ITEM_TIMEOUT_NS << self.retries, TIMEOUT_NS)
        return [self._request_message()]
