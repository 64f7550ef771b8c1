"""Channels of the 2.4 GHz band: centre frequencies, and the overlap of a signal with a receiver's filter.

Spectra are rectangular: power is spread evenly over the width, with none beyond. What a real transmitter leaks beyond
its mask (802.11-2020 15.4.5.5: at least 30 dB down) is not modelled.
"""

from __future__ import annotations

from skyrange.core.compiled import compiled
from skyrange.radio.phy.waveforms import is_wifi

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
