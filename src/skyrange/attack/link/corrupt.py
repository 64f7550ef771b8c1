"""Damage on a link: bits of selected frames are flipped, with or without a checksum that fits."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import skyrange.plugin as sky
from skyrange.codec.mavlink import message_id
from skyrange.codec.mavlink.frames import CHECKSUM, HEADER_V1, HEADER_V2, LAYOUTS, MAGIC_V2, checksum
from skyrange.core import elementary


def flip_bits(payload: bytes, start: int, stop: int, rate: float, draw: Callable[[int], tuple[float, ...]]) -> bytes:
    """A copy with each bit of the bytes `start` to `stop` - 1 flipped with the probability `rate`.

    `draw(n)` has the n-th uniforms in [0, 1), some at a time.
    """
    damaged = bytearray(payload)
    for bit in _draw_flips(rate, 8 * (stop - start), draw):
        damaged[start + bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


def _draw_flips(rate: float, bits: int, draw: Callable[[int], tuple[float, ...]]) -> Iterator[int]:
    """The bits to flip, of `bits`: gaps between flips are geometric, so that a uniform serves many bits."""
    if rate >= 1.0:
        yield from range(bits)
        return
    scale = 1.0 / elementary.log1p(-rate)
    bit, block = -1, 0
    while True:
        for uniform in draw(block):
            gap = elementary.log1p(-uniform) * scale
            if bit + 1 + gap >= bits:
                return
            bit += 1 + int(gap)
            yield bit
        block += 1


def payload_range(frame: bytes) -> range:
    """The bytes of a MAVLink frame's payload, by their places; none for what is no whole known frame."""
    if message_id(frame) not in LAYOUTS:
        return range(0)
    start = HEADER_V2 if frame[0] == MAGIC_V2 else HEADER_V1
    stop = start + frame[1]
    return range(start, stop) if stop + CHECKSUM <= len(frame) else range(0)


def mend_checksum(frame: bytes) -> bytes:
    """A whole known frame with its checksum computed anew (mavlink.io, serialization, "Checksum")."""
    number, stop = message_id(frame), payload_range(frame).stop
    assert number is not None
    crc = checksum(frame[1:stop], LAYOUTS[number].crc_extra)
    return frame[:stop] + crc.to_bytes(CHECKSUM, "little") + frame[stop + CHECKSUM :]


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

    bit_error_rate: sky.Number = sky.param("Probability that a bit is flipped.", default=0.001, gt=0, le=1)
    first_byte: sky.Whole = sky.param(
        "First byte that is damaged, from 0; a MAVLink 2 payload begins at 10.", default=0, ge=0, le=65_535
    )
    last_byte: sky.Whole | None = sky.param("Last of them; default: the frame's last.", default=None, ge=0, le=65_535)
    fix_checksum: bool = sky.param(
        "Whether payload bytes alone are damaged, and the CRC of a MAVLink frame is mended.", default=False
    )

    def find_problems(self) -> sky.Problems:
        if self.last_byte is not None and self.last_byte < self.first_byte:
            yield sky.Problem("last_byte", str(self.last_byte), f"at least first_byte, {self.first_byte}")

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        payload = frame.payload
        chosen = payload_range(payload) if self.fix_checksum else range(len(payload))
        last = len(payload) if self.last_byte is None else self.last_byte
        start, stop = max(chosen.start, self.first_byte), min(chosen.stop, last + 1)
        damaged = flip_bits(payload, start, stop, self.bit_error_rate, lambda block: self.draw(frame, block))
        if damaged == payload:
            return ()
        return (sky.Replace(payload if self.sham else mend_checksum(damaged) if self.fix_checksum else damaged),)
