"""SETUP_SIGNING: the key with which an autopilot signs its frames and verifies those that it receives.

After ArduPilot's GCS_Signing.cpp (`handle_setup_signing`, `load_signing_key`). Whoever may command the autopilot may
give it a key: while it has none, anybody. An armed one refuses since pull request 10311 of January 2019, which answers
issue 10298; it was first in Copter 4.0 (assumed from the dates). Nothing is acknowledged.
"""

from __future__ import annotations

from typing import Any, Final

from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle

_REFUSAL: Final = "ERROR: Won't setup signing when armed"


def on_setup_signing(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """SETUP_SIGNING: take the key for all channels, from the end of this step on; all zeros end signing.

    ArduPilot takes it between two frames. So frames that arrive within the same 10 ms are verified here as before it.
    """
    if fleet.armed(vehicle):
        fleet.send_text(vehicle, mav.MAV_SEVERITY_WARNING, _REFUSAL, causes)
        return
    secret, timestamp = bytes(message.secret_key), int(message.initial_timestamp)
    signs = bool(timestamp) or any(secret)
    fleet.new_keys.append((vehicle.row, (secret, timestamp) if signs else None))
    fleet.note("event.signing_key", vehicle, {"signs": signs}, causes)
