"""Damage on a link: bits of selected frames are flipped, with or without a checksum that fits."""

from __future__ import annotations

import math
from collections.abc import Iterator

import skyrange.plugin as sky
from skyrange.codec.mavlink.frame_layout import CHECKSUM, HEADER_V1, HEADER_V2, LAYOUTS, MAGIC_V2, checksum


@sky.attack(
    "link.corrupt",
    technique="T0830",
    effect="receivers reject damaged frames, or accept values that nobody sent",
    knowledge="nothing to damage frames; the message's layout and CRC_EXTRA to have a changed value accepted",
    position="on the path; damage without a mended checksum is also what a jammer near the receiver does",
    equipment="a computer that forwards the frames, or a jammer",
    content="the sham: the same frames replaced by equal ones",
    placement="the same damage on another aircraft's link, or of other messages or bytes",
)
class Damage(sky.OnPath):
    """Flips bits of selected frames, and can mend their checksums.

    Each bit of the chosen bytes is flipped with the same probability, independently. With `fix_checksum` only payload
    bytes are flipped, and the CRC is computed anew, so that receivers accept the changed values. A signature (the last
    13 bytes of a signed frame) cannot be computed without the key: a receiver that checks signatures refuses the frame
    either way.
    """

    bit_error_rate: sky.Number = sky.param(
        "Probability that a bit is flipped; 1 inverts every chosen bit.", default=0.001, gt=0, le=1
    )
    first_byte: sky.Whole = sky.param(
        "First byte that is damaged, counted from 0, the frame's first; the payload of a MAVLink 2 frame begins at 10.",
        default=0, ge=0, le=65_535,
    )  # fmt: skip
    last_byte: sky.Whole | None = sky.param(
        "Last byte that is damaged; default: the frame's last.", default=None, ge=0, le=65_535
    )
    fix_checksum: bool = sky.param(
        "Whether payload bytes alone are damaged, and the CRC of a MAVLink frame is mended.", default=False
    )

    def find_problems(self) -> sky.Problems:
        if self.last_byte is not None and self.last_byte < self.first_byte:
            yield sky.Problem("last_byte", str(self.last_byte), f"at least first_byte, {self.first_byte}")

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Replace it by a damaged copy, if any bit is flipped; in the sham by an equal copy."""
        payload = frame.payload
        start, stop = self.first_byte, len(payload) if self.last_byte is None else min(self.last_byte + 1, len(payload))
        body = _payload_range(payload) if self.fix_checksum else None
        if self.fix_checksum:
            if body is None:
                return ()
            start, stop = max(start, body[0]), min(stop, body[1])
        damaged = bytearray(payload)
        for bit in self._flips(frame, 8 * (stop - start)):
            damaged[start + bit // 8] ^= 1 << bit % 8
        if damaged == payload:
            return ()
        if body is not None:
            _mend(damaged, body[1])
        return (sky.Replace(payload if self.sham else bytes(damaged)),)

    def _flips(self, frame: sky.Frame, bits: int) -> Iterator[int]:
        """The bits to flip, of `bits`: gaps between flips are geometric, so that a draw serves many bits."""
        if self.bit_error_rate >= 1.0:
            yield from range(bits)
            return
        scale = 1.0 / math.log1p(-self.bit_error_rate)
        bit, block = -1, 0
        while True:
            for uniform in self.draw(frame, block):
                gap = math.log1p(-uniform) * scale
                if bit + 1 + gap >= bits:
                    return
                bit += 1 + int(gap)
                yield bit
            block += 1


def _payload_range(frame: bytes) -> tuple[int, int] | None:
    """First byte of a MAVLink frame's payload, and first byte behind it; `None` for what is no whole known frame."""
    if sky.message_id(frame) not in LAYOUTS:
        return None
    start = HEADER_V2 if frame[0] == MAGIC_V2 else HEADER_V1
    stop = start + frame[1]
    return (start, stop) if stop + CHECKSUM <= len(frame) else None


def _mend(frame: bytearray, stop: int) -> None:
    """Compute the checksum of a frame anew, whose payload ends before `stop` (serialization, "Checksum")."""
    number = sky.message_id(bytes(frame))
    assert number is not None
    crc = checksum(bytes(frame[1:stop]), LAYOUTS[number].crc_extra)
    frame[stop : stop + CHECKSUM] = crc.to_bytes(CHECKSUM, "little")
