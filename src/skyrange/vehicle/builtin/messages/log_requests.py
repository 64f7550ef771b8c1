"""Requests of the list of logs, which an aircraft answers while it is disarmed.

After libraries/AP_Logger/AP_Logger_MAVLinkLogTransfer.cpp: while it is armed it tells once that it is to be disarmed.
The content of logs is read as files (`file_transfer.server`), which no arming prevents; LOG_REQUEST_DATA has no answer.
"""

from __future__ import annotations

from typing import Any

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin.files.flight_log import FlightLog
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle


def on_log_request_list(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """LOG_REQUEST_LIST: a LOG_ENTRY for each log of the range, numbered from 1; one of zeros if there is none.

    They are sent at once; ArduPilot sends one in each pass of its loop.
    """
    if fleet.armed(vehicle):
        if not vehicle.log_refused:
            vehicle.log_refused = True
            fleet.send_text(vehicle, mav.MAV_SEVERITY_ERROR, "Disarm for log download", causes)
        return
    vehicle.log_refused = False
    logs = vehicle.card.logs()
    if not logs:
        fleet.send(vehicle, mav.MAVLink_log_entry_message(0, 0, 0, 0, 0), causes)
        return
    last = min(message.end, len(logs))
    for number in range(max(message.start, 1), last + 1):
        entry = logs[number - 1]
        utc_s = entry.content.utc_s if isinstance(entry.content, FlightLog) else 0
        size = len(entry.read())
        fleet.send(vehicle, mav.MAVLink_log_entry_message(number, len(logs), last, utc_s, size), causes)
