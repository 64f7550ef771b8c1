"""Barometer fusion: height and climb rate; without aiding, also the assumption of rest.

NavEKF3_core::selectHeightForFusion, the height part of FuseVelPosNED, and ResetHeight
(AP_NavEKF3_PosVelFusion.cpp), with the barometer as the source of height (EK3_SRC1_POSZ 1). GNSS height is not used,
as in that configuration.
"""

from __future__ import annotations

from typing import Any

from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin.control.shaping import clamp
from skyrange.vehicle.builtin.estimation.bad_imu import needs_height_reset
from skyrange.vehicle.builtin.estimation.covariance import (
    correct_horizontal,
    correct_vertical,
    update_horizontal_covariance,
    update_vertical_covariance,
)
from skyrange.vehicle.builtin.estimation.gnss import gate_squared
from skyrange.vehicle.builtin.estimation.state import (
    HEIGHT_MAX_M,
    HEIGHT_MIN_M,
    HGT_AVG_NS,
    HGT_RETRY_NS,
    HGT_RETRY_VEL_NS,
    INTERVAL_MIN_NS,
    Aiding,
    EstimatorEvent,
)

_NONE = int(Aiding.NONE)
_HEIGHT = int(EstimatorEvent.HEIGHT_RESET)
_FRESH_NS = 500 * NS_PER_MS
_REST_NOISE_M = 0.5  # FuseVelPosNED: noise of the assumed position before take-off


@compiled
def read_baro(e: Any, k: Any, p: Any, now: int, height: float, armed: bool) -> None:  # noqa: FBT001
    """Fuse a height that is new: another value, at most every 50 ms, or the same one after 100 ms."""
    since = now - k.baro_at
    if since < INTERVAL_MIN_NS or (height == k.baro and since < HGT_AVG_NS):
        return
    if height != height:
        _update_timeout(k, now)
        return
    k.baro = clamp(height, HEIGHT_MIN_M, HEIGHT_MAX_M)
    k.baro_at = now
    e.baro_up = k.baro
    if k.aiding == _NONE:
        _fuse_rest(e, k, p, armed)
    noise = clamp(p.EK3_ALT_M_NSE, 0.1, 100.0) ** 2
    by = k.baro - k.pos[2]
    variance = k.cov_vertical[0] + noise
    k.hgt_test = by * by / (gate_squared(p.EK3_HGT_I_GATE) * variance)
    loose = 3.0 if k.aiding == _NONE and not armed else 1.0
    passed = k.hgt_test < loose
    k.hgt_innov = by
    if passed:
        k.hgt_pass = now
    if k.hgt_timeout == 1:
        _reset_height(k, p, now, noise, armed)
    elif passed or k.bad_imu == 1:
        u = k.cov_vertical
        correct_vertical(k, update_vertical_covariance(u, u[0], u[1], u[2], variance), by)
    most = clamp(p.EK3_ACC_BIAS_LIM, 0.0, 5.0)
    k.accel_bias = clamp(k.accel_bias, -most, most)
    _update_timeout(k, now)


@compiled
def _update_timeout(k: Any, now: int) -> None:
    retry = HGT_RETRY_VEL_NS if k.vel_timeout == 0 else HGT_RETRY_NS
    k.hgt_timeout = 1 if now - k.hgt_pass > retry or needs_height_reset(k, now) else 0


@compiled
def _reset_height(k: Any, p: Any, now: int, noise: float, armed: bool) -> None:  # noqa: FBT001
    """Reset the height to the barometer; the climb rate to GNSS's in flight, to zero on the ground."""
    k.reset_delta_pos[2] += k.baro - (k.pos[2] - k.pending_pos[2])
    k.corrected_pos[2] += k.baro - k.pos[2]
    k.pos[2] = k.baro
    k.pending_pos[2] = 0.0
    climb = k.vel[2]
    if not armed:
        climb = 0.0
    elif now - k.fix_at < _FRESH_NS:
        climb = k.gnss_vel[2]
    k.reset_delta_vel[2] += climb - (k.vel[2] - k.pending_vel[2])
    k.corrected_vel[2] += climb - k.vel[2]
    k.vel[2] = climb
    k.pending_vel[2] = 0.0
    u = k.cov_vertical
    u[0], u[1], u[2], u[4] = noise, 0.0, 0.0, 0.0
    u[3] = p.EK3_VELD_M_NSE * p.EK3_VELD_M_NSE
    k.hgt_timeout = 0
    k.hgt_pass = now
    k.hgt_test = 0.0
    k.hgt_innov = 0.0
    k.events |= _HEIGHT


@compiled
def _fuse_rest(e: Any, k: Any, p: Any, armed: bool) -> None:  # noqa: FBT001
    """Without aiding, fuse the last known position, with noise EK3_NOAID_M_NSE, which keeps tilt from drifting."""
    noise = clamp(p.EK3_NOAID_M_NSE, 0.5, 50.0) if armed else _REST_NOISE_M
    c = k.cov_horizontal
    east = k.last_known_pos[0] - k.pos[0]
    north = k.last_known_pos[1] - k.pos[1]
    correct_horizontal(e, k, update_horizontal_covariance(c, c[0], c[1], c[2], c[3], c[0] + noise * noise), east, north)
