"""Noise burst requests: the messages by which a jammer orders its radio to transmit noise, on its node's `rid_up`
link.

24 bytes, little-endian, one burst per payload; 32 for a reactive jammer that follows an access point. A jammer's
program and its radio are two components, as everywhere. A burst ends by itself, so a jammer that is muted stops
transmitting.

| bytes | field | meaning |
|---|---|---|
| 0 | magic | 0x1E |
| 1 | turnaround | µs from the start of a frame to the noise of a reactive jammer; 0: noise all the time; 255: below |
| 2–3 | power | radiated power (EIRP) in 0.01 dBm, signed |
| 4–7 | centre | centre frequency in kHz |
| 8–11 | bandwidth | bandwidth in kHz, over which the power is spread evenly |
| 12–15 | duration | µs |
| 16–23 | time | ns of range time at which the burst was ordered, signed |
| 24–29 | BSSID | address of the access point that it follows |
| 30–31 | search | ms after which it finds the access point's new channel, 1…65535 |

A reactive jammer transmits only while it hears a frame in the band, and stops at the frame's end. With 255 there is
noise all the time, and the next order continues it.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

from skyrange.core.errors import DecodeError

MAGIC: Final = 0x1E
CONTINUED: Final = 255
"""In `NoiseRequest.turnaround_us`: noise all the time, which the next order of the same band continues."""
_BURST: Final = struct.Struct("<BBhIIIq")
_FOLLOW: Final = struct.Struct("<6sH")
SIZE: Final = _BURST.size


class NoiseRequest(NamedTuple):
    """Noise for `duration_us`, starting when the radio receives the request."""

    power_cdbm: int
    centre_khz: int
    bandwidth_khz: int
    duration_us: int
    time_ns: int = 0
    turnaround_us: int = 0
    bssid: bytes = b""
    """The access point that a reactive jammer follows, when it hears it on another channel; empty for none."""
    follow_ms: int = 0
    """How long that takes."""


def pack(burst: NoiseRequest) -> bytes:
    """Encode a request; raises `ValueError` if a field does not fit its bytes or the bandwidth is 0."""
    if burst.bandwidth_khz <= 0:
        raise ValueError(f"bandwidth of {burst.bandwidth_khz} kHz, expected more than 0")
    try:
        packed = _BURST.pack(MAGIC, burst.turnaround_us, *burst[:5])
        return packed + _FOLLOW.pack(burst.bssid, burst.follow_ms) if burst.bssid else packed
    except struct.error as error:
        raise ValueError(f"{burst}: {error}") from error


def unpack(payload: bytes) -> NoiseRequest:
    """Decode a request; raises `DecodeError` for anything that `pack` does not produce."""
    if len(payload) not in (SIZE, SIZE + _FOLLOW.size):
        raise DecodeError(f"{len(payload)} bytes, a burst of noise has {SIZE} or {SIZE + _FOLLOW.size}")
    magic, turnaround_us, *fields = _BURST.unpack_from(payload)
    if magic != MAGIC:
        raise DecodeError(f"first byte 0x{magic:02x}, expected 0x{MAGIC:02x}")
    power_cdbm, centre_khz, bandwidth_khz, duration_us, time_ns = fields
    follows: tuple[bytes, int] = _FOLLOW.unpack_from(payload, SIZE) if len(payload) > SIZE else (b"", 0)
    burst = NoiseRequest(power_cdbm, centre_khz, bandwidth_khz, duration_us, time_ns, turnaround_us, *follows)
    if burst.bandwidth_khz == 0:
        raise DecodeError("a burst of noise without bandwidth")
    return burst
