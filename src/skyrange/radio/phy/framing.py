"""Framing overhead of Remote ID transports: the waveform of a broadcast, and the bytes around its body.

`codec.wifi` and `codec.ble` make the frames themselves; the medium needs only their length. Wi-Fi frames are sent at 6
Mb/s, the one basic rate that the beacon announces.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from skyrange.agent.air import Waveform
from skyrange.codec import ble, wifi
from skyrange.codec.f3411 import SIZE
from skyrange.codec.rid_link import RidFrame, RidHeader, Transport

_FRAME: Final = RidFrame(RidHeader(Transport.WIFI_BEACON, channel=6), bytes(SIZE))
_AROUND = {
    Transport.BT4: len(ble.legacy(_FRAME)) - 4 - 2 - ble.CRC,
    Transport.BT5: len(ble.auxiliary(_FRAME)) - 4 - 1 - 2 - ble.CRC,
    Transport.WIFI_BEACON: len(wifi.beacon(_FRAME)),
    Transport.WIFI_NAN: len(wifi.nan_action(_FRAME)),
}
"""A frame's length with one message in it; for Bluetooth the length of its PDU's payload."""

AROUND: Final = np.array([0, *(_AROUND[transport] - SIZE for transport in Transport)])
"""By transport: bytes around the body."""
WAVEFORM: Final = np.array([0, Waveform.BLE_1M, Waveform.BLE_CODED, Waveform.OFDM_6M, Waveform.OFDM_6M])
"""By transport: its waveform."""
MOST_BODY: Final = np.array([0, SIZE, 255 - AROUND[Transport.BT5], 250, 250])
"""By transport: the longest body in bytes; a legacy advertisement holds exactly one message."""
LEAST_BODY: Final = np.array([0, SIZE, 1, 1, 1])
"""By transport: the shortest body in bytes."""
