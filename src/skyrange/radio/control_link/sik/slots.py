"""Transmit windows of a pair of SiK radios: who sends when, and which data go into which packet.

The radios send in turn (`tdm.c: tdm_serial_loop`; file names are those of ArduPilot/SiK at 50189f2, `Firmware/radio`).
One that has nothing to send sends a packet without data, which leaves the rest of its window to the other.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import Final, NamedTuple

from skyrange.core.time import NS_PER_MS, Time
from skyrange.radio.control_link.sik.modem import TRAILER_BYTES, airtime_ns
from skyrange.radio.control_link.sik.timing import TdmTiming

STATION: Final = 0
AIRCRAFT: Final = 1
"""Numbers of the radios. The window with number 0 is the station's, and begins at time 0 (assumed)."""
STATISTICS_NS: Final[Time] = 500 * NS_PER_MS
"""How often a radio tells the other what it receives (`tdm.c: tdm_serial_loop`, 32768 ticks of 16 µs, rounded)."""
STATISTICS_BYTES: Final = 4
"""`radio.h: struct statistics`."""


class Held(NamedTuple):
    """Data of one frame in a radio's buffer, or on the line to it."""

    ready: Time
    """When all of the frame is in the buffer."""
    size: int
    """Bytes that have not been sent."""
    whole: bool
    """Whether they go into one packet."""
    frame: int
    """Number of the frame, which its radio counts."""


class Sent(NamedTuple):
    """A packet on the air."""

    sender: int
    slot: int
    start: Time
    data_bytes: int
    frames: tuple[int, ...] = ()
    """Those of which it has data, in order."""
    statistics: bool = False
    """Whether it has the sender's statistics, in place of data of its computer."""


class _DutyCycle:
    """How much one radio sends, and whether it has to wait (`tdm.c: tdm_state_update`)."""

    __slots__ = ("average", "sent_ticks", "waits")

    def __init__(self) -> None:
        self.average = 0.0
        """In percent, over about 20 rounds."""
        self.sent_ticks = 0
        """Of this round."""
        self.waits = False

    def fork(self) -> _DutyCycle:
        """A second one in the same state."""
        twin = _DutyCycle()
        twin.average, twin.sent_ticks, twin.waits = self.average, self.sent_ticks, self.waits
        return twin

    def begin_round(self, round_ticks: int, most_percent: int) -> None:
        """Average what was sent in the last round, when the radio's own window begins."""
        self.average = 0.95 * self.average + 0.05 * (100.0 * self.sent_ticks) / round_ticks
        self.sent_ticks = 0
        self.waits = self.average >= most_percent


class _Stage(Enum):
    OWN = 0
    """The owner of the window may send."""
    CLOSING = 1
    """It has no more data, and has sent its statistics if they were due."""
    BONUS = 2
    """The other radio may send."""
    OVER = 3
    """Nobody sends until the next slot."""


Hears = Callable[[int, int, Time], bool]
"""Whether the other radio receives a packet without data, by sender, number of the slot, and time."""


class Slots:
    """The slots of one pair of radios, up to a time. Deep-copyable."""

    __slots__ = (
        "_air_speed_kbps",
        "_duty",
        "_duty_percent",
        "_ecc",
        "_hears",
        "_number",
        "_stage",
        "at",
        "held",
        "timing",
    )

    def __init__(
        self, timing: TdmTiming, air_speed_kbps: int, *, ecc: bool, hears: Hears, duty_percent: int = 100
    ) -> None:
        self.timing = timing
        self._duty_percent = duty_percent
        self._duty = _DutyCycle(), _DutyCycle()
        self._air_speed_kbps = air_speed_kbps
        self._ecc = ecc
        self._hears = hears
        self.held: tuple[deque[Held], deque[Held]] = (deque(), deque())
        """Data in each radio's buffer, or on the line to it, in order."""
        self.at: Time = 0
        """When the next radio decides what it sends: it is known up to then."""
        self._number = 0
        self._stage = _Stage.OWN

    def start(self, now: Time) -> None:
        """Begin with the slot in which `now` is."""
        self._begin_slot(self.number_at(now))

    def fork(self) -> Slots:
        """A second one in the same state."""
        twin = Slots(
            self.timing, self._air_speed_kbps, ecc=self._ecc, hears=self._hears, duty_percent=self._duty_percent
        )
        twin._duty = self._duty[0].fork(), self._duty[1].fork()
        twin.held = (self.held[0].copy(), self.held[1].copy())
        twin.at, twin._number, twin._stage = self.at, self._number, self._stage
        return twin

    def airtime_ns(self, data_bytes: int) -> Time:
        """How long a packet with so much data takes."""
        return airtime_ns(self._air_speed_kbps, data_bytes, ecc=self._ecc)

    def number_at(self, at: Time) -> int:
        """The number of the slot at a time; a slot ends with the silence after its window."""
        return at // self.timing.slot_ns

    def buffered_bytes(self, radio: int, now: Time) -> int:
        """Bytes of the frames that a radio has in its buffer."""
        total = 0
        for data in self.held[radio]:
            if data.ready > now:
                break
            total += data.size
        return total

    def step(self) -> Sent | None:
        """What the radio does that decides at `at`: the packet that it sends, if it sends one.

        All data that are ready by then have to be in `held`.
        """
        if self._stage is _Stage.OVER:
            self._begin_slot(self._number + 1)
            return None
        owner = self._number % 2
        sender = 1 - owner if self._stage is _Stage.BONUS else owner
        room = self.timing.room(self._number * self.timing.slot_ns + self.timing.window_ns - self.at)
        if room < 0 or self._duty[sender].waits:
            self._end_slot()
            return None
        if self._stage is not _Stage.CLOSING:
            size, frames = self._take_data(sender, room)
            if size:
                return self._send(Sent(sender, self._number, self.at, size, frames))
        if self._stage is _Stage.BONUS:
            sent = self._send(Sent(sender, self._number, self.at, 0))
            self._end_slot()
            return sent
        if self._stage is _Stage.OWN:
            self._stage = _Stage.CLOSING
            if self._statistics_due() and room >= STATISTICS_BYTES:
                return self._send(Sent(sender, self._number, self.at, STATISTICS_BYTES, statistics=True))
        heard = self._hears(sender, self._number, self.at)
        sent = self._send(Sent(sender, self._number, self.at, 0))
        if heard:
            self._stage = _Stage.BONUS
        else:
            self._end_slot()
        return sent

    def _send(self, sent: Sent) -> Sent:
        self.at += self.airtime_ns(sent.data_bytes)
        ticks = self.timing.packet_latency + (sent.data_bytes + TRAILER_BYTES) * self.timing.ticks_per_byte
        self._duty[sent.sender].sent_ticks += ticks
        return sent

    def _take_data(self, radio: int, room: int) -> tuple[int, tuple[int, ...]]:
        """The data that go into the next packet: their length, and the frames that they are of.

        As many whole frames as fit (`packet.c: mavlink_frame`), or as much of data that are not kept whole.
        """
        held, taken, frames = self.held[radio], 0, []
        while held and taken < room:
            data = held[0]
            if data.ready > self.at or (data.whole and data.size > room - taken):
                break
            part = min(data.size, room - taken)
            taken += part
            frames.append(data.frame)
            held.popleft()
            if part < data.size:
                held.appendleft(data._replace(size=data.size - part))
        return taken, tuple(frames)

    def _statistics_due(self) -> bool:
        start = self._number * self.timing.slot_ns
        return start // STATISTICS_NS != (start - 2 * self.timing.slot_ns) // STATISTICS_NS

    def _end_slot(self) -> None:
        self._stage = _Stage.OVER
        self.at = (self._number + 1) * self.timing.slot_ns

    def _begin_slot(self, number: int) -> None:
        self._number, self._stage = number, _Stage.OWN
        if self._duty_percent < 100:
            self._duty[number % 2].begin_round(2 * (self.timing.silence + self.timing.window), self._duty_percent)
        self.at = number * self.timing.slot_ns
