"""Bit errors: which bits of a frame are flipped at a rate, and a MAVLink checksum that fits the frame again."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from skyrange.codec.mavlink import message_id
from skyrange.codec.mavlink.frames import CHECKSUM, HEADER_V1, HEADER_V2, LAYOUTS, MAGIC_V2, checksum


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
    scale = 1.0 / math.log1p(-rate)
    bit, block = -1, 0
    while True:
        for uniform in draw(block):
            gap = math.log1p(-uniform) * scale
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
