"""Resets of the estimate: references move along with it, and events are reported.

AC_PosControl::handle_ekf_NE_reset and handle_ekf_U_reset keep the position and velocity targets where they were
relative to the estimate, and AC_AttitudeControl's `inertial_frame_reset` does so for yaw: the controllers see no step,
and an aircraft that holds a position does not move. But a leg of a mission is fixed to the ground, not to the aircraft:
AC_WPNav sets the target on it again in every pass (`advance_wp_target_along_track`), so that the whole jump returns as
an error of position, and the aircraft flies it off. A position target in GUIDED is approached from the moved reference,
smoothly. This is how a false position moves a real aircraft.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from skyrange.codec.mavlink import dialect
from skyrange.core.compiled import kernel
from skyrange.vehicle.builtin.attitude import turn_by
from skyrange.vehicle.builtin.estimation.state import News
from skyrange.vehicle.builtin.fleet import Fleet
from skyrange.vehicle.builtin.layout import Records
from skyrange.vehicle.builtin.shaping import wrap_pi

_RESET_NAMES = {
    News.POSITION_RESET: "position",
    News.VELOCITY_RESET: "velocity",
    News.HEIGHT_RESET: "height",
    News.YAW_RESET: "yaw",
}


@kernel
def follow(filters: Records, flight: Records) -> None:
    """Move every row's reference by the resets of its estimate, and clear them."""
    for i in range(filters.shape[0]):
        k: Any = filters[i]
        f: Any = flight[i]
        if k.news == 0:
            continue
        for axis in range(3):
            f.ref_pos[axis] += k.shift_pos[axis]
            f.ref_vel[axis] += k.shift_vel[axis]
            k.shift_pos[axis] = 0.0
            k.shift_vel[axis] = 0.0
        turn_by(f, k.shift_yaw)
        f.target_yaw = wrap_pi(f.target_yaw + k.shift_yaw)
        k.shift_yaw = 0.0


def tell(fleet: Fleet, filters: Records) -> None:
    """Move references along and report events: STATUSTEXT in EKF3's words, and a note of each jump.

    Notes: `event.estimator` {aiding: "gnss" or "none"} when aiding starts or stops, and {reset, east_m, north_m, up_m}
    for each jump, with the distance by which the estimate moved.
    """
    rows = np.flatnonzero(filters["news"])
    shifts = filters["shift_pos"][rows].tolist()
    follow(filters, fleet.flight)
    for row, (east, north, up) in zip(rows.tolist(), shifts, strict=True):
        craft = fleet.crafts[row]
        news = News(int(filters["news"][row]))
        filters["news"][row] = 0
        if news & News.STOPPED_AIDING:
            fleet.text(craft, dialect.MAV_SEVERITY_WARNING, "EKF3 IMU0 stopped aiding")
            fleet.note("event.estimator", craft, {"aiding": "none"})
            continue
        if news & News.STARTED_AIDING:
            fleet.text(craft, dialect.MAV_SEVERITY_INFO, "EKF3 IMU0 is using GPS")
            fleet.note("event.estimator", craft, {"aiding": "gnss"})
        what = " and ".join(name for kind, name in _RESET_NAMES.items() if news & kind)
        sizes = (east, north, up)
        if what and all(map(math.isfinite, sizes)):
            fleet.note("event.estimator", craft, {"reset": what, "east_m": east, "north_m": north, "up_m": up})
