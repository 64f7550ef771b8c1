"""Validity of position and altitude: ArduCopter/system.cpp `position_ok`, `ekf_alt_ok`.

From the estimator's flags (EKF_STATUS_FLAGS, `ESTIMATE.status`) and the EKF failsafe.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle

ATTITUDE: Final = dialect.EKF_ATTITUDE
UNINITIALIZED: Final = dialect.EKF_UNINITIALIZED
GLITCHING: Final = dialect.EKF_GPS_GLITCHING
_REL, _ABS = dialect.EKF_POS_HORIZ_REL, dialect.EKF_POS_HORIZ_ABS
_PRED_REL, _PRED_ABS = dialect.EKF_PRED_POS_HORIZ_REL, dialect.EKF_PRED_POS_HORIZ_ABS
_CONST = dialect.EKF_CONST_POS_MODE
_HEIGHT = dialect.EKF_POS_VERT_ABS | dialect.EKF_VELOCITY_VERT


def has_position(fleet: Fleet, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which of `rows` have a valid horizontal position.

    An absolute one, or while dead reckoning (no longer than FS_DR_TIMEOUT) a relative one. While disarmed, a predicted
    one suffices. None while the EKF failsafe is active, and none that is not finite.
    """
    status = fleet.estimate["status"][rows]
    watch = fleet.checks
    armed = fleet.flight["armed"][rows] != 0
    reckons = (watch["dr_active"][rows] != 0) & (watch["dr_timed_out"][rows] == 0)
    is_valid = np.where(
        armed,
        (status & _CONST == 0) & ((status & _ABS != 0) | (reckons & (status & _REL != 0))),
        (status & (_ABS | _PRED_ABS) != 0) | (reckons & (status & _PRED_REL != 0)),
    )
    finite = np.isfinite(fleet.estimate["pos"][rows]).all(axis=1) & np.isfinite(fleet.estimate["vel"][rows]).all(axis=1)
    return np.asarray(is_valid & finite & (watch["ekf_failsafe"][rows] == 0))


def has_altitude(fleet: Fleet, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which of `rows` have a valid height and climb rate."""
    return np.asarray(fleet.estimate["status"][rows] & _HEIGHT == _HEIGHT)


def position_ok(fleet: Fleet, vehicle: Vehicle) -> bool:
    """`has_position` for one aircraft."""
    return bool(has_position(fleet, np.array([vehicle.row]))[0])


def ekf_alt_ok(fleet: Fleet, vehicle: Vehicle) -> bool:
    """`has_altitude` for one aircraft."""
    return bool(has_altitude(fleet, np.array([vehicle.row]))[0])
