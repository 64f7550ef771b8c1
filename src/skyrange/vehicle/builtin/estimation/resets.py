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
from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.control.attitude import inertial_frame_reset
from skyrange.vehicle.builtin.control.shaping import wrap_pi
from skyrange.vehicle.builtin.estimation.state import EstimatorEvent
from skyrange.vehicle.builtin.fleet import Fleet
from skyrange.vehicle.builtin.layout import Records

_RESET_NAMES = {
    EstimatorEvent.POSITION_RESET: "position",
    EstimatorEvent.VELOCITY_RESET: "velocity",
    EstimatorEvent.HEIGHT_RESET: "height",
    EstimatorEvent.YAW_RESET: "yaw",
}
_YAW_TEXTS = {
    EstimatorEvent.EMERGENCY_YAW_RESET: (dialect.MAV_SEVERITY_WARNING, "emergency yaw reset"),
    EstimatorEvent.YAW_ALIGNED_BY_GNSS: (dialect.MAV_SEVERITY_INFO, "yaw aligned using GPS"),
}
_LANES = 2
"""EKF3 runs one filter for each of two inertial sensors, and each of them reports its reset."""


@compiled
def shift_references(filters: Records, flight: Records) -> None:
    """Move every row's reference by the resets of its estimate, and clear them."""
    for i in range(filters.shape[0]):
        k: Any = filters[i]
        f: Any = flight[i]
        if k.events == 0:
            continue
        for axis in range(3):
            f.ref_pos[axis] += k.reset_delta_pos[axis]
            f.ref_vel[axis] += k.reset_delta_vel[axis]
            k.reset_delta_pos[axis] = 0.0
            k.reset_delta_vel[axis] = 0.0
        inertial_frame_reset(f, k.reset_delta_yaw)
        f.target_yaw = wrap_pi(f.target_yaw + k.reset_delta_yaw)
        k.reset_delta_yaw = 0.0


def report_events(fleet: Fleet, filters: Records) -> None:
    """Move references along and report events: STATUSTEXT in EKF3's words, and a note of each jump.

    Notes: `event.estimator` {aiding: "gnss" or "none"} when aiding starts or stops, and {reset, east_m, north_m, up_m}
    for each jump, with the distance by which the estimate moved.
    """
    rows = np.flatnonzero(filters["events"])
    shifts = filters["reset_delta_pos"][rows].tolist()
    shift_references(filters, fleet.flight)
    for row, (east, north, up) in zip(rows.tolist(), shifts, strict=True):
        vehicle = fleet.vehicles[row]
        news = EstimatorEvent(int(filters["events"][row]))
        filters["events"][row] = 0
        if news & EstimatorEvent.STOPPED_AIDING:
            fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, "EKF3 IMU0 stopped aiding")
            fleet.note("event.estimator", vehicle, {"aiding": "none"})
            continue
        if news & EstimatorEvent.STARTED_AIDING:
            fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, "EKF3 IMU0 is using GPS")
            fleet.note("event.estimator", vehicle, {"aiding": "gnss"})
        for event, (severity, text) in _YAW_TEXTS.items():
            if news & event:
                for lane in range(_LANES):
                    fleet.send_text(vehicle, severity, f"EKF3 IMU{lane} {text}")
        what = " and ".join(name for kind, name in _RESET_NAMES.items() if news & kind)
        sizes = (east, north, up)
        if what and all(map(math.isfinite, sizes)):
            fleet.note("event.estimator", vehicle, {"reset": what, "east_m": east, "north_m": north, "up_m": up})
