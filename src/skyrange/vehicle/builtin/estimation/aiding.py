"""GNSS aiding: time-outs, aiding modes, and checks of the receiver.

NavEKF3_core::setAidingMode (AP_NavEKF3_Control.cpp), calcGpsGoodToAlign and calcGpsGoodForFlight
(AP_NavEKF3_VehicleStatus.cpp), with GNSS as the only aid: no flow, no airspeed, no beacons.
"""

from __future__ import annotations

from typing import Any

from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.builtin.control.shaping import clamp
from skyrange.vehicle.builtin.estimation.covariance import reset_position_variance, reset_velocity_variance
from skyrange.vehicle.builtin.estimation.state import (
    GPS_FAIL_NS,
    GPS_PASS_NS,
    INNOVATION_FAIL_NS,
    INNOVATION_PASS_NS,
    POS_RETRY_NO_VEL_NS,
    POS_RETRY_USE_VEL_NS,
    TILT_DRIFT_MAX_NS,
    Aiding,
    EstimatorEvent,
)

_NONE = int(Aiding.NONE)
_ABSOLUTE = int(Aiding.ABSOLUTE)
_STOPPED = int(EstimatorEvent.STOPPED_AIDING)
_STARTED = int(EstimatorEvent.STARTED_AIDING)
_POSITION = int(EstimatorEvent.POSITION_RESET)
_VELOCITY = int(EstimatorEvent.VELOCITY_RESET)
_HYSTERESIS = 1.3  # calcGpsGoodToAlign: looser once passed
_NSATS, _HDOP, _SPEED, _POSITION_ERROR, _YAW = 1, 2, 4, 8, 16  # bits of EK3_GPS_CHECK (MASK_GPS_…)
_HDOP_MAX = 2.5
_SATELLITES_MIN = 6
_HOLD_S = 10.0  # time constant of the peak hold on speed accuracy


@compiled
def set_position(k: Any, east: float, north: float) -> None:
    """Set the horizontal position, and add the jump of the output to the reset deltas."""
    for axis in range(2):
        to = east if axis == 0 else north
        k.reset_delta_pos[axis] += to - (k.pos[axis] - k.pending_pos[axis])
        k.corrected_pos[axis] += to - k.pos[axis]
        k.pos[axis] = to
        k.pending_pos[axis] = 0.0
    k.events |= _POSITION


@compiled
def set_velocity(k: Any, east: float, north: float) -> None:
    """Set the horizontal velocity, and add the jump of the output to the reset deltas."""
    for axis in range(2):
        to = east if axis == 0 else north
        k.reset_delta_vel[axis] += to - (k.vel[axis] - k.pending_vel[axis])
        k.corrected_vel[axis] += to - k.vel[axis]
        k.vel[axis] = to
        k.pending_vel[axis] = 0.0
    k.events |= _VELOCITY


@compiled
def check_aiding(k: Any, p: Any, now: int) -> None:
    """Declare position, velocity, and finally all aiding lost, after EKF3's times without an accepted measurement."""
    if k.aiding != _ABSOLUTE:
        return
    since_pos = now - k.pos_pass
    since_vel = now - k.vel_pass
    least = POS_RETRY_NO_VEL_NS  # minTestTime_ms: the smallest of all the times
    pos_used = since_pos <= least
    vel_used = since_vel <= least
    k.vel_aiding = 1 if pos_used or vel_used else 0
    if not pos_used and not vel_used and since_pos > TILT_DRIFT_MAX_NS and since_vel > TILT_DRIFT_MAX_NS:
        stop_aiding(k, p)
    elif not pos_used and since_pos > (POS_RETRY_USE_VEL_NS if vel_used else POS_RETRY_NO_VEL_NS):
        k.pos_timeout = 1
        k.vel_timeout = 0 if vel_used else 1


@compiled
def stop_aiding(k: Any, p: Any) -> None:
    """Enter constant position mode: hold the last known position, as if at rest."""
    k.aiding = _NONE
    k.pos_timeout = 1
    k.vel_timeout = 1
    k.pos_test = 0.0
    k.vel_test = 0.0
    k.last_known_pos[0] = k.pos[0]
    k.last_known_pos[1] = k.pos[1]
    set_velocity(k, 0.0, 0.0)
    reset_velocity_variance(k, p.EK3_VELNE_M_NSE * p.EK3_VELNE_M_NSE)
    set_position(k, k.last_known_pos[0], k.last_known_pos[1])
    reset_position_variance(k, p.EK3_POSNE_M_NSE * p.EK3_POSNE_M_NSE)
    k.events |= _STOPPED


@compiled
def start_aiding(k: Any, p: Any, now: int, fix: Any) -> None:
    """Start with a fix (present position, velocity): set state and variances from it."""
    k.aiding = _ABSOLUTE
    k.pos_timeout = 0
    k.vel_timeout = 0
    k.pos_pass = now
    k.vel_pass = now
    k.vel_aiding = 1
    set_velocity(k, fix[3], fix[4])
    reset_velocity_variance(k, max(p.EK3_VELNE_M_NSE, k.spd_acc) ** 2)
    set_position(k, fix[0], fix[1])
    reset_position_variance(k, max(p.EK3_POSNE_M_NSE, k.pos_acc) ** 2)
    k.events |= _STARTED


@compiled
def receiver_passes(k: Any, p: Any, h_acc: float, v_acc: float, hdop: float, satellites: int, scale: float) -> bool:
    """Whether a fix passes the checks of EK3_GPS_CHECK, their limits multiplied by `scale`."""
    mask = int(p.EK3_GPS_CHECK)
    if mask & _NSATS and satellites < _SATELLITES_MIN:
        return False
    if mask & _HDOP and hdop > _HDOP_MAX:
        return False
    if mask & _SPEED and k.spd_acc > scale:
        return False
    if mask & _POSITION_ERROR and (h_acc > 5.0 * scale or v_acc > 7.5 * scale):
        return False
    return not (mask & _YAW and k.mag_test > 1.0)


@compiled
def update_gps_good_to_align(
    k: Any, p: Any, now: int, h_acc: float, v_acc: float, hdop: float, satellites: int
) -> None:
    """Update whether GNSS is good to align: after 10 s of passed, until 5 s of failed checks (calcGpsGoodToAlign)."""
    scale = 0.01 * p.EK3_CHECK_SCALE
    if k.gps_good_to_align == 1:
        scale *= _HYSTERESIS
    if receiver_passes(k, p, h_acc, v_acc, hdop, satellites, scale):
        k.check_pass = now
    else:
        k.check_fail = now
    if k.gps_good_to_align == 0 and now - k.check_fail > GPS_PASS_NS:
        k.gps_good_to_align = 1
    elif k.gps_good_to_align == 1 and now - k.check_pass > GPS_FAIL_NS:
        k.gps_good_to_align = 0


@compiled
def update_gps_good_for_flight(k: Any, now: int, gap_ns: int, s_acc: float) -> None:
    """Update whether GNSS is glitching (calcGpsGoodForFlight), from speed accuracy and innovations."""
    k.sacc_low = clamp(0.2 * s_acc + 0.8 * k.sacc_low, 0.0, 10.0)
    decay = clamp(gap_ns / NS_PER_S / _HOLD_S, 0.0, 1.0)
    k.sacc_peak = max(k.sacc_low, (1.0 - decay) * k.sacc_peak)
    if k.sacc_peak > 1.5:
        k.sacc_good = 0
    elif k.sacc_peak < 1.0:
        k.sacc_good = 1
    if k.vel_test < 1.0 and k.pos_test < 1.0:
        k.innov_pass = now
    elif k.vel_test > 0.7 or k.pos_test > 0.7:
        k.innov_fail = now
    if now - k.innov_pass > INNOVATION_FAIL_NS:
        k.innov_good = 0
    elif now - k.innov_fail > INNOVATION_PASS_NS:
        k.innov_good = 1
