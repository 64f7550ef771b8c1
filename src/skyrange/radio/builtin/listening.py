"""Listening schedules of receivers: the channels and waveforms of real kinds of receivers, turn by turn.

The schedules are parameters, from what such receivers do:

- `COMPANION`: a module on an aircraft, one chip on Wi-Fi channel 6 (what most senders use), one that scans Bluetooth
  without a gap, 1M and Coded by turns on 37, 38, 39, 30 ms each.
- `SNIFFER`: a microcontroller in promiscuous mode, which stays on Wi-Fi channel 6 and has no Bluetooth.
- `HOPPER`: changes the Wi-Fi channel five times a second (kismet's default rate), and scans Bluetooth.
- `PHONE`: Android's app in the foreground. Bluetooth in SCAN_MODE_LOW_LATENCY, 100 ms windows in 100 ms intervals
  (AOSP `ScanManager`); Wi-Fi scans are throttled to four in two minutes (developer.android.com, "Wi-Fi scanning
  overview"), each modelled as 13 channels of 110 ms.
- `PHONE_IDLE`: the same phone in its pocket: SCAN_MODE_LOW_POWER, 140 ms windows in 1400 ms intervals; no Wi-Fi.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.medium import Ints, ScanSchedule, ScanStep, Waveform
from skyrange.core.compiled import compiled
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, Time
from skyrange.radio.builtin.state import ALWAYS, DWELL, FIRST, PHASE, REST, TURNS, WIFI, WINDOW
from skyrange.radio.phy import ADVERTISING_CHANNELS, WIFI_CHANNELS

_WIFI = (Waveform.DSSS_1M, Waveform.OFDM_6M)


def wifi_chain(channel: int = 6) -> ScanSchedule:
    """A chain that stays on one Wi-Fi channel."""
    return ScanSchedule((ScanStep(channel, _WIFI),))


def bluetooth_chain(window_ns: Time, interval_ns: Time, *, coded: bool = True) -> ScanSchedule:
    """A chain that scans the advertising channels by turns, one interval each; with `coded`, 1M and Coded by turns
    too.
    """
    kinds = (Waveform.BLE_1M, Waveform.BLE_CODED) if coded else (Waveform.BLE_1M,)
    turns = tuple(ScanStep(channel, (kind,)) for channel in ADVERTISING_CHANNELS for kind in kinds)
    return ScanSchedule(turns, interval_ns, window_ns)


def wifi_scan_chain(dwell_ns: Time, rest_ns: Time = 0) -> ScanSchedule:
    """A chain that scans all Wi-Fi channels and then pauses."""
    return ScanSchedule(tuple(ScanStep(channel, _WIFI) for channel in WIFI_CHANNELS), dwell_ns, dwell_ns, rest_ns)


COMPANION: Final = (wifi_chain(6), bluetooth_chain(30 * NS_PER_MS, 30 * NS_PER_MS))
SNIFFER: Final = (wifi_chain(6),)
HOPPER: Final = (wifi_scan_chain(200 * NS_PER_MS), bluetooth_chain(30 * NS_PER_MS, 30 * NS_PER_MS))
PHONE: Final = (
    wifi_scan_chain(110 * NS_PER_MS, 30 * NS_PER_S - 13 * 110 * NS_PER_MS),
    bluetooth_chain(100 * NS_PER_MS, 100 * NS_PER_MS),
)
PHONE_IDLE: Final = (bluetooth_chain(140 * NS_PER_MS, 1400 * NS_PER_MS),)

PROFILES: Final[dict[str, tuple[ScanSchedule, ...]]] = {
    "companion": COMPANION,
    "sniffer": SNIFFER,
    "hopper": HOPPER,
    "phone": PHONE,
    "phone-idle": PHONE_IDLE,
    "none": (),
}
"""Receivers by the names that scenarios use."""


@compiled
def listening_turn(turns: int, dwell: int, window: int, rest: int, phase: int, time_ns: int) -> tuple[int, int]:
    """The turn in which a chain is listening, -1 if it is not, and until when. Scalars only, because it is called
    often.
    """
    if dwell == ALWAYS:
        return 0, NEVER
    if turns == 0:
        return -1, 0
    into = (time_ns + phase) % (turns * dwell + rest)
    turn = into // dwell
    left = window - (into - turn * dwell)
    if turn >= turns or left <= 0:
        return -1, 0
    return turn, time_ns + left


@compiled
def find_tuned(
    chain: Ints, turn_channel: Ints, radio: Ints, channel: Ints, start: Ints, end: Ints
) -> NDArray[np.bool_]:
    """(k,): whether each receiver listened to a Wi-Fi channel from the start to the end of a frame, in ns.

    `chain` and `turn_channel` are those of `state.Radios`.
    """
    tuned = np.zeros(radio.shape[0], dtype=np.bool_)
    for k in range(radio.shape[0]):
        own = chain[radio[k], WIFI]
        if own[TURNS] == 0:
            continue
        turn, until = listening_turn(own[TURNS], own[DWELL], own[WINDOW], own[REST], own[PHASE], start[k])
        tuned[k] = turn >= 0 and until >= end[k] and turn_channel[own[FIRST] + turn] == channel[k]
    return tuned
