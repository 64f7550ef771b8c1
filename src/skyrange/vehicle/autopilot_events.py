"""Kinds of events of autopilots: one list for all engines, so that what one of them notes the others note too."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

AUTOPILOT_EVENTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "event.armed": "",
        "event.bad_frame": "ArduPilot drops bytes that are not a frame, and sends no message about them",
        "event.battery": "",
        "event.disarmed": "",
        "event.ekf_failsafe": "",
        "event.estimator": "",
        "event.fence": "",
        "event.fence_breach": "",
        "event.fence_cleared": "",
        "event.file": "ArduPilot sends no message about its files but the replies to a client, which name no path",
        "event.glitch": "",
        "event.home": "",
        "event.item_reached": "",
        "event.landed": "",
        "event.mission": "",
        "event.mode": "",
        "event.parameter": "",
        "event.rally": "",
        "event.reboot": "",
        "event.signing_key": "ArduPilot stores a key, and sends no message about it",
        "event.signature_refused": "ArduPilot drops frames with a wrong signature, and sends no message about them",
        "event.takeoff": "",
    }
)
"""The kinds that the builtin autopilot notes; by each, why none is read from an ArduPilot, or "" where it is.

`vehicle.event_detection` reads those of ArduPilots and external vehicles from their messages.
"""
