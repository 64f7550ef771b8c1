"""Reports of SiK radios to their computers: RADIO_STATUS on the serial side of each radio.

File names are those of ArduPilot/SiK at 50189f2, `Firmware/radio`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.frames import checksum
from skyrange.contracts.components import Tap
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.verdicts import Direction, Inject, Verdict
from skyrange.core.time import Time
from skyrange.radio.control_link.sik.link import SikLink
from skyrange.radio.control_link.sik.radio import RadioReport
from skyrange.radio.control_link.sik.slots import AIRCRAFT, STATION

SENDER: Final = (ord("3"), ord("D"))
"""System and component id of all radios (`mavlink.c: RADIO_SOURCE_SYSTEM`, `RADIO_SOURCE_COMPONENT`)."""
_STX: Final = {1: 0xFE, 2: 0xFD}
"""First byte of a frame, by version of MAVLink."""
_HEARTBEAT_BYTES: Final = 9
_NUMBER: Final = int(dialect.MAVLINK_MSG_ID_RADIO_STATUS)
_CRC_EXTRA: Final = int(dialect.MAVLink_radio_status_message.crc_extra)
_SIDES: Final = {STATION: "gcs", AIRCRAFT: "companion"}


def heartbeat_version(payload: bytes) -> int:
    """The version of MAVLink of a frame that a radio takes for a HEARTBEAT, or 0 (`packet.c: check_response`)."""
    if len(payload) > 9:
        if payload[0] == _STX[1] and payload[1] == _HEARTBEAT_BYTES and payload[5] == 0:
            return 1
        if payload[0] == _STX[2] and payload[1] <= _HEARTBEAT_BYTES and not any(payload[7:10]):
            return 2
    return 0


def pack_report(report: RadioReport, sequence: int, version: int) -> bytes:
    """RADIO_STATUS as a radio sends it: unsigned, and with all zeros at its end (`mavlink.c: MAVLink_report`)."""
    content = b"".join(
        (
            report.receive_errors.to_bytes(2, "little"),
            report.corrected_packets.to_bytes(2, "little"),
            bytes([report.rssi, report.remote_rssi, report.free_percent, report.noise, report.remote_noise]),
        )
    )
    flags = b"\0\0" if version == 2 else b""
    number = _NUMBER.to_bytes(3 if version == 2 else 1, "little")
    covered = bytes([len(content)]) + flags + bytes([sequence, *SENDER]) + number + content
    return bytes([_STX[version]]) + covered + checksum(covered, bytes([_CRC_EXTRA])).to_bytes(2, "little")


class StatusReporter:
    """The tap by which a radio reports to its computer, once after each HEARTBEAT that the computer sends.

    It alters nothing that passes. Deep-copyable with its link.
    """

    def __init__(self, link: SikLink, end: int) -> None:
        self._link = link
        self._end = end
        self._to_computer: Direction = "rev" if end == STATION else "fwd"
        self._due: Time | None = None
        self._version = 0
        self._sequence = 0
        self._to = ""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Note a HEARTBEAT of the computer. The report is due when line and report have been on the serial lines."""
        if frame.direction == self._to_computer or not self._link.keeps_whole(len(frame.payload)):
            return ()
        version = heartbeat_version(frame.payload)
        if version:
            self._version, self._to = version, frame.src
            if self._due is None:
                lines = len(frame.payload) + len(pack_report(RadioReport(*[0] * 7), 0, version))
                self._due = now + lines * self._link.radios[self._end].byte_ns
        return ()

    def next_wakeup(self) -> Time | None:
        """When the next report is due."""
        return self._due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Report."""
        if self._due is None or now < self._due:
            return ()
        self._due = None
        payload = pack_report(self._link.report(self._end, now), self._sequence, self._version)
        self._sequence = (self._sequence + 1) % 256
        return (Inject(payload, self._to_computer, self._link.radios[self._end].name, self._to),)


@dataclass(frozen=True, slots=True)
class _MakeReporter:
    """Makes the tap of one radio, for a link's name."""

    link: SikLink
    end: int

    def __call__(self, link: str) -> Tap:
        return StatusReporter(self.link, self.end)


def place_reporters(links: Sequence[SikLink]) -> list[TapPlacement]:
    """The taps of all radios that report; place them last, because radios are next to the channel."""
    return [
        TapPlacement(link.name, side, _MakeReporter(link, end))
        for link in links
        if link.params.mavlink
        for end, side in _SIDES.items()
    ]
