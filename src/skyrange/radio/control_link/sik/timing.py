"""Time slots and frequencies of SiK radios, in the integer arithmetic of the firmware.

File names are those of the firmware, ArduPilot/SiK at commit 50189f2, in `Firmware/radio`.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from skyrange.core.time import NS_PER_US, Time
from skyrange.radio.control_link.sik.modem import TRAILER_BYTES, max_data_bytes

TICK_NS: Final[Time] = 16 * NS_PER_US
"""Unit of all times of the firmware (`timer.h: timer2_tick`)."""
MAX_CHANNELS: Final = 50
"""`freq_hopping.h: MAX_FREQ_CHANNELS`."""
MAX_WINDOW_MS: Final = 131
"""Longest transmit window: a trailer has 13 bits for it (`parameters.c: param_check`)."""
MAX_SPACING_HZ: Final = 2_550_000
"""`radio_443x.c: radio_set_frequency`."""
SPACING_STEP_HZ: Final = 10_000
"""Step of the register of the channel spacing (`radio_set_frequency`)."""
_REGULATORY_TICKS: Final = 25_000
"""0.4 s on one frequency (`tdm.c: REGULATORY_MAX_WINDOW`)."""
_TRAILER_TICKS: Final = 0x1FFF
_OVERHEAD_BYTES: Final = TRAILER_BYTES + 16
"""Less room than for so many bytes is not used (`tdm.c: PACKET_OVERHEAD`)."""


class TdmTiming(NamedTuple):
    """Lengths of time slots in ticks of 16 µs, and what fits into them."""

    ticks_per_byte: int
    packet_latency: int
    """Of a packet without data, as the firmware estimates it."""
    silence: int
    """Between the windows of the two radios."""
    window: int
    """In which one of the radios sends."""
    max_data_bytes: int
    """Of one packet."""

    @property
    def slot_ns(self) -> Time:
        """From the beginning of one radio's window to that of the other's."""
        return (self.window + self.silence) * TICK_NS

    @property
    def window_ns(self) -> Time:
        """Length of a window."""
        return self.window * TICK_NS

    def room(self, remaining_ns: Time) -> int:
        """Bytes of data in a packet that a radio may send so long before the end of a window; -1 if it sends none.

        `tdm.c: tdm_serial_loop`: the firmware keeps one byte more than the trailer needs.
        """
        ticks = remaining_ns // TICK_NS - self.packet_latency
        if ticks < 0 or ticks // self.ticks_per_byte < _OVERHEAD_BYTES:
            return -1
        return min(ticks // self.ticks_per_byte - (TRAILER_BYTES + 1), self.max_data_bytes)


def compute_timing(air_speed_kbps: int, *, ecc: bool, max_window_ms: int, channels: int) -> TdmTiming:
    """The timing that both radios compute from their parameters (`tdm.c: tdm_init`), without listen before talk."""
    ticks_per_byte = (8 + 8000 // air_speed_kbps) // 16 + 1
    packet_latency = (8 + 10 // 2) * ticks_per_byte + 13
    if ecc:
        ticks_per_byte *= 2
        packet_latency += 4 * ticks_per_byte
    silence = 2 * packet_latency
    data_bytes = max_data_bytes(ecc=ecc)
    window = 3 * (packet_latency + data_bytes * ticks_per_byte)
    if channels > 1:
        window = min(window, _REGULATORY_TICKS)
    window = min(window, max_window_ms * (1000 // 16), _TRAILER_TICKS)
    packet_latency += (16 - 10) // 2 * ticks_per_byte
    return TdmTiming(ticks_per_byte, packet_latency, silence, window, data_bytes)


class _Rand:
    """The generator of `freq_hopping.c: r_rand`, with the 16-bit integers of the compiler SDCC."""

    def __init__(self, seed: int) -> None:
        self._next = seed & 0xFFFF

    def draw(self) -> int:
        """A number from 0 to 32767."""
        self._next = (self._next * 1_103_515_245 + 12_345) & 0xFFFF_FFFF
        return (self._next >> 16) & 0x7FFF


def draw_hop_order(netid: int, channels: int) -> tuple[int, ...]:
    """The order in which radios of a network use the channels (`freq_hopping.c: fhop_init`)."""
    rand, order = _Rand(netid), list(range(channels))
    for place in range(channels - 1):
        other = (rand.draw() & 0xFF) % channels
        order[place], order[other] = order[other], order[place]
    return tuple(order)


def spacing_hz(min_khz: int, max_khz: int, channels: int) -> int:
    """Distance of the channels as computed (`main.c: radio_init`); the radio rounds it to 10 kHz."""
    return (max_khz - min_khz) * 1000 // (channels + 2)


def find_centres_mhz(netid: int, min_khz: int, max_khz: int, channels: int) -> tuple[float, ...]:
    """Centre frequencies by channel (`main.c: radio_init`): half a spacing inside, moved by the network id.

    The product that moves them overflows 16 bits, and its sign is extended (assumed of SDCC, ISO C 6.3.1.3).
    """
    spacing = spacing_hz(min_khz, max_khz, channels)
    base = min_khz * 1000 + spacing // 2
    if channels > 5:
        product = (_Rand(netid).draw() * 625) & 0xFFFF
        base += (product - 0x1_0000 if product >= 0x8000 else product) % (1 << 32) % spacing
    step = (spacing + SPACING_STEP_HZ // 2) // SPACING_STEP_HZ * SPACING_STEP_HZ
    return tuple((base + channel * step) / 1e6 for channel in range(channels))
