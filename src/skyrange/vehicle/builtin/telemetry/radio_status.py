"""Pace of streams by the buffer of a telemetry radio: software flow control (`GCS_MAVLINK::handle_radio_status`).

libraries/GCS_MAVLink/GCS_Common.cpp of ArduPilot. ArduPilot heeds any RADIO_STATUS; here an aircraft does only if its
control link is over such a radio.
"""

from __future__ import annotations

from typing import Any, Final

from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle

MAX_SLOWDOWN_MS: Final = 2000
"""From here on intervals are not made longer."""


def next_slowdown_ms(slowdown_ms: int, free_percent: int) -> int:
    """What is added to every interval after a report that so much of the radio's buffer is free."""
    if free_percent < 20 and slowdown_ms < MAX_SLOWDOWN_MS:
        return slowdown_ms + 60
    if free_percent < 50 and slowdown_ms < MAX_SLOWDOWN_MS:
        return slowdown_ms + 20
    if free_percent > 95 and slowdown_ms > 200:
        return slowdown_ms - 40
    if free_percent > 90 and slowdown_ms:
        return max(slowdown_ms - 20, 0)
    return slowdown_ms


def on_radio_status(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """RADIO_STATUS, or RADIO of older radios: make the intervals of the streams longer or shorter."""
    if not vehicle.has_telemetry_radio:
        return
    slowdown_ms = next_slowdown_ms(vehicle.stream_slowdown_ms, message.txbuf)
    if slowdown_ms != vehicle.stream_slowdown_ms:
        vehicle.stream_slowdown_ms = slowdown_ms
        fleet.stream_delays_ns[vehicle.row] = slowdown_ms * NS_PER_MS
