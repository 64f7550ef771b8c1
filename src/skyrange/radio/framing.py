"""What is a Remote ID broadcast on the air? Which waveform carries it, and how long its frame is around its body.

The bytes themselves are made by `codec.wifi` and `codec.ble`; their length is all that a medium asks for. Wi-Fi frames
go at 6 Mb/s, the one basic rate that the beacon announces.
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
"""A frame's length with a message in it; of a Bluetooth one that of its PDU's payload."""

AROUND: Final = np.array([0, *(_AROUND[transport] - SIZE for transport in Transport)])
"""By transport: bytes around the body."""
WAVEFORM: Final = np.array([0, Waveform.BLE_1M, Waveform.BLE_CODED, Waveform.OFDM_6M, Waveform.OFDM_6M])
"""By transport."""
MOST_BODY: Final = np.array([0, SIZE, 255 - AROUND[Transport.BT5], 250, 250])
"""By transport: the longest body; a legacy advertisement holds one message, never less."""
LEAST_BODY: Final = np.array([0, SIZE, 1, 1, 1])
