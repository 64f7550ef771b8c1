"""Physical layer at 2.4 GHz: waveforms, channels, and the framing of Remote ID.

Airtimes: IEEE 802.11-2020 15.2.3 (DSSS, long preamble 144 µs and header 48 µs), 17.3.2 and 18.3.2.4 (OFDM: 20 µs, 24
bits in each 4 µs symbol, 6 µs signal extension at 2.4 GHz); Bluetooth Core 5.4 vol. 6 part B 2.1 (1M) and 2.2 (Coded:
preamble 80, access address 256, CI 16, TERM1 24, TERM2 24 µs, and 64 µs per byte at S=8).

Bit errors, γ being the ratio of signal to noise and interference in the waveform's own width:

- DSSS 1 Mb/s: DBPSK despread from 22 MHz, 0.5·exp(−22γ); G. Pei & T. Henderson, "Validation of ns-3 802.11b PHY model"
  (2009), as in ns-3's `DsssErrorRateModel`.
- OFDM 6 Mb/s: BPSK 0.5·erfc(√γ), and the union bound of the rate 1/2 code over Bhattacharyya's D; L. Miller, NIST,
  "Validation of 802.11a/UWB Coexistence Simulation" (2003), as in ns-3's `NistErrorRateModel` (G. Pei & T. Henderson,
  "Validation of OFDM error rate model in ns-3", 2010).
- BLE 1M: GFSK of index 0.5 as noncoherent orthogonal FSK, 0.5·exp(−γ/2) (Proakis, "Digital Communications", 5.4-47;
  the Bluetooth model of IEEE 802.15.2-2003 reduces to that at index 0.5): 0.1 % at 10.9 dB.
- BLE Coded S=8: four symbols per coded bit, so 0.5·exp(−4γ/2), then hard decisions on the rate 1/2 code of constraint
  length 4 (Core vol. 6 part B 3.3.1), by its distance spectrum (Frenger, Orten & Ottosson, IEEE Comm. Letters 3/11,
  1999: 15, 17 octal). That gains 8 to 9 dB over 1M; the nRF52840's data sheet has 8 (−95 and −103 dBm).

Spectra are rectangular: power is spread evenly over the width, with none beyond. What a real transmitter leaks beyond
its mask (802.11-2020 15.4.5.5: at least 30 dB down) is not modelled.

`codec.remote_id.wifi` and `codec.remote_id.ble` make the frames of Remote ID; the medium needs only their length. Wi-Fi
frames are sent at 6 Mb/s, the one basic rate that the beacon announces.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from skyrange.codec.f3411 import SIZE
from skyrange.codec.remote_id import ble, wifi
from skyrange.codec.remote_id.link_payload import RidFrame, RidHeader, Transport
from skyrange.contracts.medium import Waveform
from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_US, Time

DSSS, OFDM, BLE, CODED = (int(w) for w in Waveform)

WIDTH_MHZ: Final = np.array([22.0, 20.0, 1.0, 1.0])
"""By waveform: width of the signal and of its receiver's filter."""
MIN_SNIR_DB: Final = np.array([-8.1, 1.8, 8.3, 1.3])
"""By waveform: below this fewer than 1 in 100 frames of 30 bytes survive (checked by a test)."""
LOCK_SNIR_DB: Final = np.array([-6.2, 2.3, 10.3, 2.0])
"""By waveform: from this on a receiver detects the preamble and locks on the frame; about half survive there."""
MAX_BYTES: Final = np.array([2346, 2346, 37, 255])
"""By waveform: longest frame. 802.11-2020 table 9-25 (2304 and headers); Core vol. 6 part B 2.3.1, 2.3.4."""
MIN_BYTES: Final = np.array([14, 14, 6, 6])

_HEAD_BITS: Final = np.array([48, 24, 40, 40])


@compiled
def is_wifi(waveform: int) -> bool:
    """Whether a waveform is one of 802.11."""
    return waveform < 2


@compiled
def airtime_ns(waveform: int, size_bytes: int) -> Time:
    """Duration of a frame on the air, including its preamble."""
    if waveform == DSSS:
        us = 192 + 8 * size_bytes
    elif waveform == OFDM:
        us = 26 + 4 * ((16 + 6 + 8 * size_bytes + 23) // 24)
    elif waveform == BLE:
        us = 8 * (1 + 4 + 2 + size_bytes + 3)
    else:
        us = 80 + 256 + 16 + 24 + 64 * (2 + size_bytes + 3) + 24
    return int(us * NS_PER_US)


@compiled
def frame_bits(waveform: int, size_bytes: int) -> int:
    """Number of bits that must be right: those of the frame and of its header."""
    return int(8 * size_bytes + _HEAD_BITS[waveform])


@compiled
def bit_error(waveform: int, snir: float) -> float:
    """The probability 0…0.5 that a bit is wrong after decoding; `snir` is a ratio of powers."""
    if waveform == DSSS:
        return 0.5 * elementary.exp(-22.0 * snir)
    if waveform == BLE:
        return 0.5 * elementary.exp(-0.5 * snir)
    if waveform == OFDM:
        p = 0.5 * elementary.erfc(math.sqrt(snir))
        d2 = 4.0 * p * (1.0 - p)
        bound = 134365911.0
        for weight in (21292910.0, 3322763.0, 502690.0, 77433.0, 11633.0, 1404.0, 211.0, 36.0):
            bound = bound * d2 + weight
        return min(0.5 * bound * d2 * d2 * d2 * d2 * d2, 0.5)
    p = 0.5 * elementary.exp(-2.0 * snir)
    d = math.sqrt(4.0 * p * (1.0 - p))
    bound = 2069.0
    for weight in (836.0, 333.0, 130.0, 49.0, 18.0, 7.0, 2.0):
        bound = bound * d + weight
    return min(0.5 * bound * d * d * d * d * d * d, 0.5)


@compiled
def bits_success_probability(waveform: int, snir: float, bits: float) -> float:
    """The probability that all of `bits` are right (a share of a frame has a fractional number of bits)."""
    return elementary.exp(bits * elementary.log1p(-bit_error(waveform, snir)))


def packet_error(waveform: Waveform, snir_db: float, size_bytes: int) -> float:
    """The probability that a frame of `size_bytes` is lost at a constant `snir_db`."""
    return 1.0 - bits_success_probability(
        int(waveform), elementary.exp10(snir_db / 10.0), float(frame_bits(int(waveform), size_bytes))
    )


WIFI_CHANNELS = range(1, 14)
ADVERTISING_CHANNELS = (37, 38, 39)
DATA_CHANNELS = 37


@compiled
def centre_mhz(waveform: int, channel: int) -> float:
    """Centre of a Wi-Fi channel (802.11-2020 15.4.4.3) or BLE channel index (Core vol. 6 part B 1.4.1)."""
    if is_wifi(waveform):
        return 2407.0 + 5.0 * channel
    if channel == 37:
        return 2402.0
    if channel == 38:
        return 2426.0
    if channel == 39:
        return 2480.0
    return 2404.0 + 2.0 * channel if channel < 11 else 2406.0 + 2.0 * channel


@compiled
def filter_overlap(centre: float, width: float, receiver_centre: float, receiver_width: float) -> float:
    """The share 0…1 of a signal's power that passes a receiver's filter; all arguments in MHz."""
    low = max(centre - 0.5 * width, receiver_centre - 0.5 * receiver_width)
    high = min(centre + 0.5 * width, receiver_centre + 0.5 * receiver_width)
    return max(high - low, 0.0) / width


_FRAME: Final = RidFrame(RidHeader(Transport.WIFI_BEACON, channel=6), bytes(SIZE))
_FRAME_BYTES = {
    Transport.BT4: len(ble.encode_legacy(_FRAME)) - 4 - 2 - ble.CRC,
    Transport.BT5: len(ble.encode_auxiliary(_FRAME)) - 4 - 1 - 2 - ble.CRC,
    Transport.WIFI_BEACON: len(wifi.encode_beacon(_FRAME)),
    Transport.WIFI_NAN: len(wifi.encode_nan_action(_FRAME)),
}
"""A frame's length with one message in it; for Bluetooth the length of its PDU's payload."""

OVERHEAD_BYTES: Final = np.array([0, *(_FRAME_BYTES[transport] - SIZE for transport in Transport)])
"""By transport: bytes around the body."""
TRANSPORT_WAVEFORM: Final = np.array([0, Waveform.BLE_1M, Waveform.BLE_CODED, Waveform.OFDM_6M, Waveform.OFDM_6M])
"""By transport: its waveform."""
MAX_BODY_BYTES: Final = np.array([0, SIZE, 255 - OVERHEAD_BYTES[Transport.BT5], 250, 250])
"""By transport: the longest body in bytes; a legacy advertisement holds exactly one message."""
MIN_BODY_BYTES: Final = np.array([0, SIZE, 1, 1, 1])
"""By transport: the shortest body in bytes."""
