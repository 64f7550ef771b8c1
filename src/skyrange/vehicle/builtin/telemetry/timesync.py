"""TIMESYNC: the answer to a request for the time (GCS_Common.cpp `handle_timesync`)."""

from __future__ import annotations

from typing import Any

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle


def on_timesync(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """Answer a request (`tc1` 0) with the time since boot, to which ArduPilot adds its system id."""
    if message.tc1 != 0:
        return
    since_ns = max(fleet.now - int(fleet.boot_ns[vehicle.row]), 0) // 1000 * 1000 + vehicle.system_id
    fleet.send(vehicle, mav.MAVLink_timesync_message(since_ns, message.ts1), causes)
