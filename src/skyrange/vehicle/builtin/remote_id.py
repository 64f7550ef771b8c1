"""Is the Remote ID transmitter good to fly with? What it says, and the pre-arm check of it.

After libraries/AP_OpenDroneID/AP_OpenDroneID.cpp (`pre_arm_check`) and AP_Arming.cpp (`opendroneid_checks`): enforced
where bit 0 of DID_OPTIONS is set, as 14 CFR 89.310(c)(2) asks. ArduPilot hands the transmitter what to broadcast and
checks that a ground station gave it an identity and an operator location; here the companion makes the broadcast
of what it hears, and checks these itself: its OPEN_DRONE_ID_ARM_STATUS is the answer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NS_PER_S, Time
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet

_ENFORCE: Final = 1  # DID_OPTIONS bit 0: EnforceArming
_AGE_NS: Final[Time] = 3 * NS_PER_S  # max_age_ms
_GOOD: Final = int(dialect.MAV_ODID_ARM_STATUS_GOOD_TO_ARM)


def on_arm_status(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """OPEN_DRONE_ID_ARM_STATUS: keep the last one (`handle_msg`)."""
    fleet.watch["rid_ns"][craft.row] = max(fleet.now, 1)
    fleet.watch["rid_status"][craft.row] = message.status
    error = message.error
    text = error if isinstance(error, str) else bytes(error).split(b"\0")[0].decode("ascii", "replace")
    craft.rid_error = "".join(letter if letter.isprintable() else "?" for letter in text)


def troubles(fleet: Fleet, rows: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.bool_], str | Callable[[Craft], str]]]:
    """Which of some rows may not be armed, and why."""
    settings, watch = fleet.settings, fleet.watch
    asked = settings["DID_OPTIONS"][rows].astype(np.int64) & _ENFORCE != 0
    heard = watch["rid_ns"][rows]
    yield asked & (settings["DID_ENABLE"][rows] == 0), "OpenDroneID: DID_ENABLE must be 1"
    yield asked & ((heard == 0) | (fleet.now - heard > _AGE_NS)), "OpenDroneID: ARM_STATUS not available"
    yield asked & (watch["rid_status"][rows] != _GOOD), lambda craft: f"OpenDroneID: {craft.rid_error}"
