"""Does the autopilot trust its position? ArduCopter/system.cpp `position_ok`, `ekf_alt_ok`.

By the estimator's flags (EKF_STATUS_FLAGS, `ESTIMATE.status`) and the estimator failsafe.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fleet import Craft, Fleet

ATTITUDE: Final = dialect.EKF_ATTITUDE
UNINITIALIZED: Final = dialect.EKF_UNINITIALIZED
GLITCHING: Final = dialect.EKF_GPS_GLITCHING
_REL, _ABS = dialect.EKF_POS_HORIZ_REL, dialect.EKF_POS_HORIZ_ABS
_PRED_REL, _PRED_ABS = dialect.EKF_PRED_POS_HORIZ_REL, dialect.EKF_PRED_POS_HORIZ_ABS
_CONST = dialect.EKF_CONST_POS_MODE
_HEIGHT = dialect.EKF_POS_VERT_ABS | dialect.EKF_VELOCITY_VERT


def known(fleet: Fleet, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of some rows have a horizontal position to fly by.

    Absolute, or while dead reckoning (no longer than FS_DR_TIMEOUT) relative. Disarmed, one that the estimator
    expects to have does. None while the estimator failsafe is on, none that is not finite.
    """
    status = fleet.estimate["status"][rows]
    watch = fleet.watch
    armed = fleet.flight["armed"][rows] != 0
    reckons = (watch["reckoning"][rows] != 0) & (watch["reckoning_over"][rows] == 0)
    good = np.where(
        armed,
        (status & _CONST == 0) & ((status & _ABS != 0) | (reckons & (status & _REL != 0))),
        (status & (_ABS | _PRED_ABS) != 0) | (reckons & (status & _PRED_REL != 0)),
    )
    finite = np.isfinite(fleet.estimate["pos"][rows]).all(axis=1) & np.isfinite(fleet.estimate["vel"][rows]).all(axis=1)
    return np.asarray(good & finite & (watch["ekf_lost"][rows] == 0))


def height_known(fleet: Fleet, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of some rows know height and climb rate."""
    return np.asarray(fleet.estimate["status"][rows] & _HEIGHT == _HEIGHT)


def ok(fleet: Fleet, craft: Craft) -> bool:
    """`known` for one craft."""
    return bool(known(fleet, np.array([craft.row]))[0])


def height_ok(fleet: Fleet, craft: Craft) -> bool:
    """`height_known` for one craft."""
    return bool(height_known(fleet, np.array([craft.row]))[0])
