"""Framing overhead of Remote ID transports: the waveform of a broadcast, and the bytes around its body.

`codec.remote_id.wifi` and `codec.remote_id.ble` make the frames themselves; the medium needs only their length. Wi-Fi
frames are sent at 6 Mb/s, the one basic rate that the beacon announces.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from skyrange.codec.f3411 import SIZE
from skyrange.codec.remote_id import ble, wifi
from skyrange.codec.remote_id.link_payload import RidFrame, RidHeader, Transport
from skyrange.contracts.medium import Waveform

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
