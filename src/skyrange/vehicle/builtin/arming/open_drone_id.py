"""Pre-arm check of the Remote ID transmitter, and the messages that it and the ground station send.

After libraries/AP_OpenDroneID/AP_OpenDroneID.cpp (`handle_msg`, `pre_arm_check`) and AP_Arming.cpp
(`opendroneid_checks`): enforced where bit 0 of DID_OPTIONS is set, as 14 CFR 89.310(c)(2) requires. The transmitter
reports its status, a ground station the identity of the aircraft and the place of its operator; here the companion
sends all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NS_PER_S, Time
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle

_ENFORCE: Final = 1  # DID_OPTIONS bit 0: EnforceArming
_MAX_AGE_NS: Final[Time] = 3 * NS_PER_S  # max_age_ms
_GOOD: Final = int(dialect.MAV_ODID_ARM_STATUS_GOOD_TO_ARM)


def on_arm_status(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """OPEN_DRONE_ID_ARM_STATUS: store the status and its error text."""
    fleet.checks["rid_ns"][vehicle.row] = max(fleet.now, 1)
    fleet.checks["rid_status"][vehicle.row] = message.status
    error = message.error
    text = error if isinstance(error, str) else bytes(error).split(b"\0")[0].decode("ascii", "replace")
    vehicle.rid_error = "".join(letter if " " <= letter <= "~" else "?" for letter in text)


def on_basic_id(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """OPEN_DRONE_ID_BASIC_ID: store its id type."""
    fleet.checks["rid_id_type"][vehicle.row] = message.id_type


def on_system(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """OPEN_DRONE_ID_SYSTEM: store whether there is an operator location."""
    _store_operator_location(fleet, vehicle, message)
    fleet.checks["rid_system_ns"][vehicle.row] = max(fleet.now, 1)


def on_system_update(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """OPEN_DRONE_ID_SYSTEM_UPDATE: a newer location, valid only after an OPEN_DRONE_ID_SYSTEM."""
    _store_operator_location(fleet, vehicle, message)
    if fleet.checks["rid_system_ns"][vehicle.row]:
        fleet.checks["rid_system_ns"][vehicle.row] = max(fleet.now, 1)


def _store_operator_location(fleet: Fleet, vehicle: Vehicle, message: Any) -> None:
    fleet.checks["rid_operator"][vehicle.row] = message.operator_latitude != 0 or message.operator_longitude != 0


def prearm_failures(
    fleet: Fleet, rows: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.bool_], str | Callable[[Vehicle], str]]]:
    """Return which of `rows` may not be armed, and why."""
    settings, watch = fleet.settings, fleet.checks
    asked = settings["DID_OPTIONS"][rows].astype(np.int64) & _ENFORCE != 0
    yield asked & (settings["DID_ENABLE"][rows] == 0), "OpenDroneID: DID_ENABLE must be 1"
    yield asked & (watch["rid_id_type"][rows] == 0), "OpenDroneID: UA_TYPE required in BasicID"
    yield asked & (watch["rid_operator"][rows] == 0), "OpenDroneID: operator location must be set"
    yield asked & _is_stale(fleet, watch["rid_ns"][rows]), "OpenDroneID: ARM_STATUS not available"
    yield asked & _is_stale(fleet, watch["rid_system_ns"][rows]), "OpenDroneID: SYSTEM not available"
    yield asked & (watch["rid_status"][rows] != _GOOD), lambda vehicle: f"OpenDroneID: {vehicle.rid_error}"


def _is_stale(fleet: Fleet, heard_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    missing: NDArray[np.bool_] = (heard_ns == 0) | (fleet.now - heard_ns > _MAX_AGE_NS)
    return missing
