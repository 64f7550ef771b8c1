"""Is the mission in the autopilot? The MAVLink mission protocol from the ground station's side.

https://mavlink.io/en/services/mission.html: upload (MISSION_COUNT, items on request, MISSION_ACK) and
download (MISSION_REQUEST_LIST, items by request, MISSION_ACK), with its default timeouts. Beyond it,
because links lose, repeat and reorder: every request for an item in range is answered, whichever
and however often; INVALID_SEQUENCE (ArduPilot's answer to an item that came twice) is not a failure;
an ACCEPTED counts only once the last item was asked for, so that an old one is not believed; and what
a peer refuses for now (ERROR, DENIED while another transfer runs, OPERATION_CANCELLED) is begun again.
"""

from __future__ import annotations

from dataclasses import dataclass

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import NEVER, NS_PER_MS, Time
from skyrange.gcs.commands import result_name
from skyrange.gcs.wire_items import WireItem, difference

TIMEOUT_NS = 1_500 * NS_PER_MS
"""mavlink.io "Timeouts and retries": default."""
ITEM_TIMEOUT_NS = 250 * NS_PER_MS
"""mavlink.io "Timeouts and retries": mission items. Doubled with each retry, up to `TIMEOUT_NS`: over a link whose
answers take longer, asking ever again at this pace would end before the first one came."""
MAX_RETRIES = 5
"""mavlink.io "Timeouts and retries": retries before cancelling."""
MAX_ATTEMPTS = 3
"""How often a whole transfer is begun that was refused for now or broke off."""

_FOR_NOW = frozenset({mav.MAV_MISSION_ERROR, mav.MAV_MISSION_DENIED, mav.MAV_MISSION_OPERATION_CANCELLED})
_HOME_SEQ = 0
"""ArduPilot keeps item 0 itself: its home, whatever was uploaded."""


@dataclass(slots=True)
class Transfer:
    """What upload and download share: the peer, when something is due, and how it went.

    `result` is empty while under way, `"done"` at the end, else why it was given up.
    """

    items: tuple[WireItem, ...]
    system: int
    component: int
    due: Time = NEVER
    retries: int = 0
    attempts: int = 0
    result: str = ""

    def begin(self, now: Time) -> list[Message]:
        """Begin, or begin again; what to send."""
        self.attempts += 1
        self.retries = 0
        self.due = now + TIMEOUT_NS
        return [self._opening()]

    def on_time(self, now: Time) -> list[Message]:
        """What to send at `due`: the last message again, or the opening where all begins anew."""
        if now < self.due or self.result:
            return []
        self.retries += 1
        if self.retries > MAX_RETRIES:
            return self._again(now, "no answer")
        return self._repeat(now)

    def on_ack(self, now: Time, kind: int) -> None:
        """MISSION_ACK with result `kind` (MAV_MISSION_RESULT)."""
        raise NotImplementedError

    def _refused(self, now: Time, kind: int) -> None:
        """A negative MISSION_ACK."""
        reason = result_name("MAV_MISSION_RESULT", "MAV_MISSION_", kind)
        if kind in _FOR_NOW and self.attempts < MAX_ATTEMPTS:
            self.retries = MAX_RETRIES  # the next `on_time` begins again, after what is under way has settled
            self.due = now + TIMEOUT_NS
        else:
            self._end(f"{self._name()} refused: {reason}")

    def _again(self, now: Time, reason: str) -> list[Message]:
        if self.attempts < MAX_ATTEMPTS:
            return self.begin(now)
        self._end(f"{self._name()}: {reason} in {self.attempts} attempts")
        return []

    def _end(self, result: str) -> None:
        self.result = result
        self.due = NEVER

    def _name(self) -> str:
        raise NotImplementedError

    def _opening(self) -> Message:
        raise NotImplementedError

    def _repeat(self, now: Time) -> list[Message]:
        raise NotImplementedError


@dataclass(slots=True)
class Upload(Transfer):
    """The mission goes up."""

    last_sent: int = -1
    complete: bool = False
    """Whether the last item was asked for in this attempt."""

    def begin(self, now: Time) -> list[Message]:
        """Announce the number of items."""
        self.last_sent = -1
        self.complete = False
        return Transfer.begin(self, now)

    def on_request(self, now: Time, seq: int) -> list[Message]:
        """MISSION_REQUEST_INT or MISSION_REQUEST for item `seq`: the item, if there is one.

        Also after the end, for requests that come late.
        """
        if seq >= len(self.items):
            return []
        if not self.result:
            self.last_sent = seq
            self.complete = self.complete or seq == len(self.items) - 1
            self.retries = 0
            self.due = now + TIMEOUT_NS
        return [self.items[seq].message(seq, self.system, self.component)]

    def on_ack(self, now: Time, kind: int) -> None:
        """MISSION_ACK."""
        if self.result or kind == mav.MAV_MISSION_INVALID_SEQUENCE:
            return
        if kind == mav.MAV_MISSION_ACCEPTED:
            if self.complete:
                self._end("done")
        else:
            self._refused(now, kind)

    def _name(self) -> str:
        return "mission upload"

    def _opening(self) -> Message:
        return mav.MAVLink_mission_count_message(
            self.system, self.component, len(self.items), mav.MAV_MISSION_TYPE_MISSION
        )

    def _repeat(self, now: Time) -> list[Message]:
        self.due = now + TIMEOUT_NS
        if self.last_sent < 0:
            return [self._opening()]
        return [self.items[self.last_sent].message(self.last_sent, self.system, self.component)]


@dataclass(slots=True)
class Download(Transfer):
    """The mission is read back and compared with what was sent."""

    wanted: int = -1
    """The item asked for; -1 while the count is awaited."""

    def begin(self, now: Time) -> list[Message]:
        """Ask for the list."""
        self.wanted = -1
        return Transfer.begin(self, now)

    def on_count(self, now: Time, count: int) -> list[Message]:
        """MISSION_COUNT: ask for the first item, or see that the number is wrong."""
        if self.result or self.wanted >= 0:
            return []
        if count != len(self.items):
            self._end(f"read-back differs: {count} items, sent {len(self.items)}")
            return [self._closing(mav.MAV_MISSION_OPERATION_CANCELLED)]
        return self._ask(now, _HOME_SEQ)

    def on_item(self, now: Time, item: Message) -> list[Message]:
        """MISSION_ITEM_INT: ask for the next one, or close; others than the one asked for are ignored."""
        if self.result or item.seq != self.wanted:
            return []
        problem = difference(self.items[item.seq], item) if item.seq != _HOME_SEQ else ""
        if problem:
            self._end(f"read-back differs at item {item.seq}: {problem}")
            return [self._closing(mav.MAV_MISSION_OPERATION_CANCELLED)]
        if item.seq == len(self.items) - 1:
            self._end("done")
            return [self._closing(mav.MAV_MISSION_ACCEPTED)]
        return self._ask(now, item.seq + 1)

    def on_ack(self, now: Time, kind: int) -> None:
        """MISSION_ACK: only a refusal means anything here."""
        if not self.result and kind not in (mav.MAV_MISSION_ACCEPTED, mav.MAV_MISSION_INVALID_SEQUENCE):
            self._refused(now, kind)

    def _ask(self, now: Time, seq: int) -> list[Message]:
        self.wanted = seq
        self.retries = 0
        self.due = now + ITEM_TIMEOUT_NS
        return [self._asking()]

    def _asking(self) -> Message:
        return mav.MAVLink_mission_request_int_message(
            self.system, self.component, self.wanted, mav.MAV_MISSION_TYPE_MISSION
        )

    def _closing(self, kind: int) -> Message:
        return mav.MAVLink_mission_ack_message(self.system, self.component, kind, mav.MAV_MISSION_TYPE_MISSION)

    def _name(self) -> str:
        return "mission read-back"

    def _opening(self) -> Message:
        return mav.MAVLink_mission_request_list_message(self.system, self.component, mav.MAV_MISSION_TYPE_MISSION)

    def _repeat(self, now: Time) -> list[Message]:
        if self.wanted < 0:
            self.due = now + TIMEOUT_NS
            return [self._opening()]
        self.due = now + min(ITEM_TIMEOUT_NS << self.retries, TIMEOUT_NS)
        return [self._asking()]
