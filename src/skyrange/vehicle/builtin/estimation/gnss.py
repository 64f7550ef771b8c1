"""GNSS aiding: checks of the receiver, aiding modes, and the fusion of a fix.

NavEKF3_core::readGpsData (AP_NavEKF3_Measurements.cpp), FuseVelPosNED, ResetPosition and ResetVelocity
(AP_NavEKF3_PosVelFusion.cpp). A fix is some tenths of a second old: it is compared with the state at its time, and the
correction is applied to the present state and to all states in between, as in EKF3's delayed time horizon.

GNSS aiding: time-outs, aiding modes, and checks of the receiver. NavEKF3_core::setAidingMode (AP_NavEKF3_Control.cpp),
calcGpsGoodToAlign and calcGpsGoodForFlight (AP_NavEKF3_VehicleStatus.cpp), with GNSS as the only aid: no flow, no
airspeed, no beacons.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.builtin.control.shaping import clamp
from skyrange.vehicle.builtin.estimation.bad_imu import update_bad_imu
from skyrange.vehicle.builtin.estimation.covariance import (
    correct_horizontal,
    correct_vertical,
    reset_position_variance,
    reset_velocity_variance,
    update_horizontal_covariance,
    update_vertical_covariance,
)
from skyrange.vehicle.builtin.estimation.state import (
    GPS_FAIL_NS,
    GPS_PASS_NS,
    HEIGHT_MAX_M,
    HISTORY_LENGTH,
    INNOVATION_FAIL_NS,
    INNOVATION_PASS_NS,
    POS_LIMIT_M,
    POS_RETRY_NO_VEL_NS,
    POS_RETRY_USE_VEL_NS,
    STEP_NS,
    TILT_DRIFT_MAX_NS,
    VEL_LIMIT_MPS,
    Aiding,
    EstimatorEvent,
)

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
def receiver_passes(k: Any, p: Any, h_acc: float, v_acc: float, hdop: float, satellites: int, scale: float) -> bool:  # noqa: PLR0917
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
def update_gps_good_to_align(  # noqa: PLR0917
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


_NONE = int(Aiding.NONE)
_FIX_3D = 3
_MAX_ACCURACY_M = 100.0
_MAX_ACCURACY_MPS = 50.0
_VEL_ACCEL = 0.05  # gpsNEVelVarAccScale
_ACCURACY_DECAY = 0.2  # per second: decay of a bad stated accuracy (0.0002 per ms)
_RANGE_ERROR_M = 1.5  # stated accuracy over dilution of precision
_MAX_GAP_NS = 10 * NS_PER_S


@compiled
def gate_squared(percent: float) -> float:
    """Return a gate's square: `EK3_…_I_GATE` is in hundredths of a standard deviation, at least one."""
    wide = max(0.01 * percent, 1.0)
    return wide * wide


@compiled
def claimed_accuracy(value: float, worst: float) -> float:
    """Return the receiver's stated accuracy, or `worst` where it is not a number."""
    return clamp(value, 0.0, worst) if value == value else worst


@compiled
def update_receiver_status(e: Any, k: Any, now: int, kind: int, satellites: int) -> None:
    """Update the receiver's status, in every step."""
    e.gnss_fix = min(max(kind, 0), 8)
    e.gnss_sats = min(max(satellites, 0), 255)
    e.gnss_age_s = (now - k.fix_at) / NS_PER_S


@compiled
def process_fix(  # noqa: PLR0917
    e: Any,
    k: Any,
    p: Any,
    now: int,
    kind: int,
    satellites: int,
    time: int,
    position: Any,
    velocity: Any,
    accuracy: Any,
    history: Any,
    i: int,
    slot: int,
    fix: Any,
) -> None:
    """Check a new fix and fuse it. `fix` is a buffer of six numbers."""
    k.fix_time = time
    if kind < _FIX_3D:
        return
    for axis in range(3):
        if not (math.isfinite(position[i, axis]) and math.isfinite(velocity[i, axis])):
            return
    most = POS_LIMIT_M
    for axis in range(3):
        if axis == 2:
            most = HEIGHT_MAX_M
        fix[axis] = clamp(position[i, axis], -most, most)
        fix[3 + axis] = clamp(velocity[i, axis], -VEL_LIMIT_MPS, VEL_LIMIT_MPS)
        e.gnss_pos[axis] = fix[axis]
        e.gnss_vel[axis] = fix[3 + axis]
        k.gnss_vel[axis] = fix[3 + axis]
    h_acc = claimed_accuracy(accuracy[i, 0], _MAX_ACCURACY_M)
    v_acc = claimed_accuracy(accuracy[i, 1], _MAX_ACCURACY_M)
    s_acc = claimed_accuracy(accuracy[i, 2], _MAX_ACCURACY_MPS)
    e.gnss_acc[0], e.gnss_acc[1], e.gnss_acc[2] = h_acc, v_acc, s_acc
    hdop = clamp(h_acc / _RANGE_ERROR_M, 0.5, 99.99)
    e.gnss_hdop = hdop
    gap = min(max(now - k.fix_at, 0), _MAX_GAP_NS)
    k.fix_at = now
    e.gnss_age_s = 0.0
    keep = 1.0 - clamp(_ACCURACY_DECAY * gap / NS_PER_S, 0.0, 1.0)
    k.spd_acc = clamp(max(k.spd_acc * keep, s_acc), p.EK3_VELNE_M_NSE, _MAX_ACCURACY_MPS)
    k.pos_acc = clamp(max(k.pos_acc * keep, h_acc), p.EK3_POSNE_M_NSE, _MAX_ACCURACY_M)
    update_gps_good_to_align(k, p, now, h_acc, v_acc, hdop, satellites)
    update_gps_good_for_flight(k, now, gap, s_acc)

    late = min(max(now - time, 0), (HISTORY_LENGTH - 2) * STEP_NS)
    if k.aiding == _NONE:
        if k.gps_good_to_align == 1:
            _extrapolate(fix, late)
            start_aiding(k, p, now, fix)
            e.resets += 1
        return
    then = history[i, (slot - (late + STEP_NS // 2) // STEP_NS) & (HISTORY_LENGTH - 1)]
    _fuse_vel_pos(e, k, p, now, satellites, late, fix, then)


@compiled
def _extrapolate(fix: Any, late: int) -> None:
    """Extrapolate a fix to the present at its own velocity (ResetPosition's tdiff)."""
    fix[0] += fix[3] * late / NS_PER_S
    fix[1] += fix[4] * late / NS_PER_S


@compiled
def _fuse_vel_pos(e: Any, k: Any, p: Any, now: int, satellites: int, late: int, fix: Any, then: Any) -> None:  # noqa: PLR0917
    """FuseVelPosNED for one fix: test position, test velocity, then fuse what passed."""
    noise = 1.0 if satellites >= 6 else (1.4 if satellites == 5 else 2.0)  # gpsNoiseScaler
    speed_of_turn2 = k.accel_slow[0] ** 2 + k.accel_slow[1] ** 2 + k.accel_slow[2] ** 2
    vel_check = clamp(p.EK3_VELNE_M_NSE, 0.05, 5.0) ** 2 + _VEL_ACCEL * _VEL_ACCEL * speed_of_turn2
    pos_noise = clamp(k.pos_acc, p.EK3_POSNE_M_NSE, _MAX_ACCURACY_M) ** 2
    vel_noise = clamp(k.spd_acc, p.EK3_VELNE_M_NSE, _MAX_ACCURACY_MPS) ** 2
    climb_noise = clamp(k.spd_acc, p.EK3_VELD_M_NSE, _MAX_ACCURACY_MPS) ** 2
    d_e = fix[0] - then[0] - k.corrected_pos[0]
    d_n = fix[1] - then[1] - k.corrected_pos[1]
    v_e = fix[3] - then[3] - k.corrected_vel[0]
    v_n = fix[4] - then[4] - k.corrected_vel[1]
    v_u = fix[5] - then[5] - k.corrected_vel[2]
    bad = update_bad_imu(k, now, fix[5], v_u, climb_noise, clamp(p.EK3_ALT_M_NSE, 0.1, 100.0) ** 2)
    if bad:
        v_u = 0.0

    spread = 2.0 * (k.cov_horizontal[0] + pos_noise)
    k.pos_test = (d_e * d_e + d_n * d_n) / (gate_squared(p.EK3_POS_I_GATE) * spread)
    widen_pos = 1.0
    pos_passed = k.pos_test < 1.0
    if pos_passed:
        k.pos_pass = now
    elif p.EK3_GLITCH_RAD <= 0.0:  # no radius: an outlier is fused with the weight of one at the gate
        k.pos_pass = now
        widen_pos = k.pos_test
        pos_passed = True
    fuse_pos = pos_passed or k.pos_timeout == 1 or bad
    fuse_vel = True
    if fuse_pos:
        radius = p.EK3_GLITCH_RAD
        unsure = radius > 0.0 and 2.0 * k.cov_horizontal[0] > radius * radius
        if (k.pos_timeout == 1 or unsure) and (k.vel_aiding == 0 or k.gps_good_to_align == 1):
            _reset_position(e, k, p, now, late, fix)
            fuse_pos = False
            if k.vel_timeout == 1:
                _reset_velocity(k, p, now, fix)
                fuse_vel = False

    if fuse_vel:
        climb_check = vel_check
        spread = 2.0 * (k.cov_horizontal[4] + vel_check) + k.cov_vertical[3] + climb_check
        k.vel_test = (v_e * v_e + v_n * v_n + v_u * v_u) / (gate_squared(p.EK3_VEL_I_GATE) * spread)
        widen_vel = 1.0
        passed = k.vel_test < 1.0
        if passed:
            k.vel_pass = now
        elif p.EK3_GLITCH_RAD <= 0.0:
            k.vel_pass = now
            widen_vel = k.vel_test
            passed = True
        if k.vel_timeout == 1:
            _reset_velocity(k, p, now, fix)
        elif passed or bad:
            _fuse_velocity(e, k, v_e, v_n, v_u, vel_noise * noise * noise, climb_noise * noise * noise, widen_vel)
            if fuse_pos:  # minus what the velocity fusion has corrected
                d_e = fix[0] - then[0] - k.corrected_pos[0]
                d_n = fix[1] - then[1] - k.corrected_pos[1]
    if fuse_pos:
        variance = widen_pos * (k.cov_horizontal[0] + pos_noise * noise * noise)
        c = k.cov_horizontal
        correct_horizontal(e, k, update_horizontal_covariance(c, c[0], c[1], c[2], c[3], variance), d_e, d_n)


@compiled
def _fuse_velocity(  # noqa: PLR0917
    e: Any, k: Any, east: float, north: float, up: float, noise: float, climb_noise: float, widen: float
) -> None:
    c = k.cov_horizontal
    correct_horizontal(
        e, k, update_horizontal_covariance(c, c[1], c[4], c[5], c[6], widen * (c[4] + noise)), east, north
    )
    u = k.cov_vertical
    correct_vertical(k, update_vertical_covariance(u, u[1], u[3], u[4], widen * (u[3] + climb_noise)), up)


@compiled
def _reset_position(e: Any, k: Any, p: Any, now: int, late: int, fix: Any) -> None:
    """Reset the position to the fix, with half the glitch radius as its standard deviation."""
    set_position(k, fix[0] + fix[3] * late / NS_PER_S, fix[1] + fix[4] * late / NS_PER_S)
    reset_position_variance(k, (0.5 * p.EK3_GLITCH_RAD) ** 2)
    k.pos_timeout = 0
    k.pos_pass = now
    k.pos_test = 0.0
    e.resets += 1


@compiled
def _reset_velocity(k: Any, p: Any, now: int, fix: Any) -> None:
    set_velocity(k, fix[3], fix[4])
    reset_velocity_variance(k, max(p.EK3_VELNE_M_NSE, k.spd_acc) ** 2)
    k.vel_timeout = 0
    k.vel_pass = now
    k.vel_test = 0.0
