"""One SiK radio: its buffers, and what it measures and counts, in the integer arithmetic of the firmware.

File names are those of ArduPilot/SiK at 50189f2, `Firmware/radio`.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from skyrange.core.time import NS_PER_S, Time

RECEIVE_BUFFER: Final = 1850
"""For bytes from the computer; one stays free (`serial.c: RX_BUFF_MAX`, `BUF_NOT_FULL`)."""
SEND_BUFFER: Final = 645
"""For bytes to the computer; one stays free (`serial.c: TX_BUFF_MAX`)."""
BITS_PER_BYTE: Final = 10
"""On a serial line, with start and stop bit."""
_ZEROED: Final = 5
"""Half seconds without a packet after which what the other radio told is forgotten (`tdm.c: link_update`)."""
_UNLOCKED: Final = 40
"""Half seconds without a packet after which a radio searches for the other (`link_update`)."""
_SEARCHING: Final = 5
_COUNT_LIMIT: Final = 0xFFFF


class RadioReport(NamedTuple):
    """What a radio tells its computer in RADIO_STATUS (`mavlink.c: MAVLink_report`)."""

    rssi: int
    remote_rssi: int
    free_percent: int
    """Of the buffer for bytes from the computer."""
    noise: int
    remote_noise: int
    receive_errors: int
    corrected_packets: int


class SikRadio:
    """A radio of a pair. Switched on at the beginning of the run: averages begin at 0, as in the firmware."""

    __slots__ = (
        "_heard", "_last_rssi", "_unheard", "byte_ns", "corrected_packets", "line_busy_until", "locked", "name",
        "noise", "out_busy_until", "power_dbm", "receive_errors", "remote_noise", "remote_rssi", "row", "rssi",
    )  # fmt: skip

    def __init__(self, name: str, power_dbm: float, serial_bps: int) -> None:
        self.name = name
        self.power_dbm = power_dbm
        self.row = -1
        """Its row among all radios."""
        self.line_busy_until: Time = -(2**62)
        """Until when the line from the computer is in use."""
        self.out_busy_until: Time = -(2**62)
        """The same of the line to the computer."""
        self.locked = True
        """Whether it follows the other's frequencies; radios have found each other before the run (assumed)."""
        self.rssi = self.noise = self.remote_rssi = self.remote_noise = 0
        self.receive_errors = self.corrected_packets = 0
        self._last_rssi = 0
        self._heard = False
        self._unheard = 0
        self.byte_ns: Time = BITS_PER_BYTE * NS_PER_S // serial_bps
        """Time of a byte on the lines."""

    # ---------------------------------------------------------------- serial lines

    def receive_from_computer(self, now: Time, size: int, queue_bytes: int) -> Time | None:
        """When all bytes of a frame that its computer sends at `now` have come; `None` if they do not fit into the
        computer's queue.
        """
        if max(self.line_busy_until - now, 0) // self.byte_ns + size > queue_bytes:
            return None
        self.line_busy_until = max(now, self.line_busy_until) + size * self.byte_ns
        return self.line_busy_until

    def send_to_computer(self, at: Time, size: int) -> Time | None:
        """When its computer has all bytes of a frame received at `at`; `None` if they find the buffer full."""
        waiting = max(self.out_busy_until - at, 0) // self.byte_ns
        if waiting + size >= SEND_BUFFER:
            return None
        self.out_busy_until = max(at, self.out_busy_until) + size * self.byte_ns
        return self.out_busy_until

    # ---------------------------------------------------------------- what it measures

    def note_noise(self, rssi: int) -> None:
        """Take the RSSI before a transmission."""
        self.noise = (rssi + 3 * self.noise) // 4

    def note_packet(self, rssi: int) -> None:
        """Take the RSSI of a packet that it has received."""
        self._heard = self.locked = True
        self._last_rssi = rssi
        self.rssi = (rssi + 7 * self.rssi) // 8

    def note_damaged(self) -> None:
        """Count a packet that it could not decode."""
        self.receive_errors = min(self.receive_errors + 1, _COUNT_LIMIT)

    def note_corrected(self) -> None:
        """Count a packet whose errors it has corrected."""
        self.corrected_packets = min(self.corrected_packets + 1, _COUNT_LIMIT)

    def note_statistics(self, other: SikRadio) -> None:
        """Take over what the other radio measures."""
        self.remote_rssi, self.remote_noise = other.rssi, other.noise

    def update_link(self) -> bool:
        """Do what it does every half second (`tdm.c: link_update`); returns whether it has lost the other radio."""
        self._unheard = 0 if self._heard else self._unheard + 1
        self._heard = False
        lost = False
        if self._unheard > _UNLOCKED:
            self._unheard = _SEARCHING
            lost, self.locked = self.locked, False
        if self._unheard:
            self.rssi = (self._last_rssi + 3 * self.rssi) // 4
        if self._unheard > _ZEROED:
            self.remote_rssi = self.remote_noise = 0
        return lost

    def report(self, buffered_bytes: int) -> RadioReport:
        """Its report, with so many bytes in its buffer (`serial.c: serial_read_space`)."""
        free = 100 * ((RECEIVE_BUFFER - buffered_bytes) // 8) // (RECEIVE_BUFFER // 8)
        counts = self.receive_errors, self.corrected_packets
        return RadioReport(self.rssi, self.remote_rssi, free, self.noise, self.remote_noise, *counts)
