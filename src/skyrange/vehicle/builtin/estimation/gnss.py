"""GNSS fusion: a fix is read, tested against its gates, then fused, rejected, or used for a reset.

NavEKF3_core::readGpsData (AP_NavEKF3_Measurements.cpp), FuseVelPosNED, ResetPosition and ResetVelocity
(AP_NavEKF3_PosVelFusion.cpp). A fix is some tenths of a second old: it is compared with the state at its time, and the
correction is applied to the present state and to all states in between, as in EKF3's delayed time horizon.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.builtin.control.shaping import clamp
from skyrange.vehicle.builtin.estimation.aiding import (
    set_position,
    set_velocity,
    start_aiding,
    update_gps_good_for_flight,
    update_gps_good_to_align,
)
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
    HEIGHT_MAX_M,
    HISTORY_LENGTH,
    POS_LIMIT_M,
    STEP_NS,
    VEL_LIMIT_MPS,
    Aiding,
)

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
def process_fix(
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
def _fuse_vel_pos(e: Any, k: Any, p: Any, now: int, satellites: int, late: int, fix: Any, then: Any) -> None:
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
def _fuse_velocity(
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
