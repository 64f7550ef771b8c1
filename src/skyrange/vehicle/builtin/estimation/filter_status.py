"""Filter status: flags and normalised innovations.

NavEKF3_core::updateFilterStatus, healthy, getVariances and send_status_report (AP_NavEKF3_Control.cpp,
AP_NavEKF3_Outputs.cpp): the contents of EKF_STATUS_REPORT, read by pre-arm checks and failsafes.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.estimation.state import Aiding, Status

_ABSOLUTE = int(Aiding.ABSOLUTE)
_NONE = int(Aiding.NONE)
_ATTITUDE = int(Status.ATTITUDE)
_VELOCITY_HORIZ = int(Status.VELOCITY_HORIZ)
_VELOCITY_VERT = int(Status.VELOCITY_VERT)
_POS_HORIZ_REL = int(Status.POS_HORIZ_REL | Status.PRED_POS_HORIZ_REL)
_POS_HORIZ = int(Status.POS_HORIZ_REL | Status.POS_HORIZ_ABS | Status.PRED_POS_HORIZ_REL | Status.PRED_POS_HORIZ_ABS)
_POS_VERT_ABS = int(Status.POS_VERT_ABS)
_POS_VERT_AGL = int(Status.POS_VERT_AGL)
_CONST_POS = int(Status.CONST_POS_MODE)
_GLITCHING = int(Status.GPS_GLITCHING)


@compiled
def update_filter_status(e: Any, k: Any, p: Any, ranged: bool) -> None:
    """Update the status fields of the estimate; `ranged` is whether the rangefinder sees the ground.

    Dead reckoning is a position that has timed out while the wind is known (`doingWindRelNav`), which a copter knows
    only with EK3_DRAG_BCOEF_X or _Y. Drag is not fused here: the position is extrapolated.
    """
    e.vel_ratio = math.sqrt(k.vel_test)
    e.pos_ratio = math.sqrt(k.pos_test)
    e.hgt_ratio = math.sqrt(k.hgt_test)
    e.mag_ratio = math.sqrt(k.mag_test)
    navigating = k.aiding == _ABSOLUTE and k.pos_timeout == 0
    knows_wind = p.EK3_DRAG_BCOEF_X > 0.0 or p.EK3_DRAG_BCOEF_Y > 0.0
    reckons = k.aiding == _ABSOLUTE and k.pos_timeout == 1 and knows_wind
    e.dead_reckoning = 1 if reckons else 0
    flags = 0
    if not (k.vel_test > 1.0 and k.pos_test > 1.0 and k.hgt_test > 1.0):
        flags = _ATTITUDE
        if reckons or not (k.vel_timeout == 1 and k.pos_timeout == 1):
            flags |= _VELOCITY_HORIZ
        if k.vel_timeout == 0 or k.hgt_timeout == 0:
            flags |= _VELOCITY_VERT
        if navigating:
            flags |= _POS_HORIZ
        elif reckons:
            flags |= _POS_HORIZ_REL
        if k.hgt_timeout == 0:
            flags |= _POS_VERT_ABS
        if ranged:
            flags |= _POS_VERT_AGL
        if k.aiding == _NONE:
            flags |= _CONST_POS
    if k.aiding == _ABSOLUTE and not (k.sacc_good == 1 and k.innov_good == 1):
        flags |= _GLITCHING
    e.status = flags
