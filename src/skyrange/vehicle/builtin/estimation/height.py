"""Barometer fusion: height and climb rate; without aiding, also the assumption of rest.

NavEKF3_core::selectHeightForFusion, the height part of FuseVelPosNED, and ResetHeight
(AP_NavEKF3_PosVelFusion.cpp), with the barometer as the source of height (EK3_SRC1_POSZ 1). GNSS height is not used,
as in that configuration.
"""

from __future__ import annotations

from typing import Any

from skyrange.core.compiled import kernel
from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin.estimation.covariance import correct_level, correct_up, take_level, take_up
from skyrange.vehicle.builtin.estimation.disbelief import height_lost
from skyrange.vehicle.builtin.estimation.gnss import gate
from skyrange.vehicle.builtin.estimation.state import (
    HEIGHT_MAX_M,
    HEIGHT_MIN_M,
    HEIGHT_NS,
    HGT_RETRY_NS,
    HGT_RETRY_VEL_NS,
    INTERVAL_MIN_NS,
    Aiding,
    News,
)
from skyrange.vehicle.builtin.shaping import clamp

_NONE = int(Aiding.NONE)
_HEIGHT = int(News.HEIGHT_RESET)
_FRESH_NS = 500 * NS_PER_MS
_REST_NOISE_M = 0.5  # FuseVelPosNED: noise of the assumed position before take-off


@kernel
def read_baro(e: Any, k: Any, p: Any, now: int, height: float, armed: bool) -> None:
    """Fuse a height that is new: another value, at most every 50 ms, or the same one after 100 ms."""
    since = now - k.baro_at
    if since < INTERVAL_MIN_NS or (height == k.baro and since < HEIGHT_NS):
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
    variance = k.up[0] + noise
    k.hgt_test = by * by / (gate(p.EK3_HGT_I_GATE) * variance)
    loose = 3.0 if k.aiding == _NONE and not armed else 1.0
    passed = k.hgt_test < loose
    k.hgt_off = by
    if passed:
        k.hgt_pass = now
    if k.hgt_timeout == 1:
        _reset_height(k, p, now, noise, armed)
    elif passed or k.bad == 1:
        u = k.up
        correct_up(k, take_up(u, u[0], u[1], u[2], variance), by)
    most = clamp(p.EK3_ACC_BIAS_LIM, 0.0, 5.0)
    k.accel_bias = clamp(k.accel_bias, -most, most)
    _update_timeout(k, now)


@kernel
def _update_timeout(k: Any, now: int) -> None:
    retry = HGT_RETRY_VEL_NS if k.vel_timeout == 0 else HGT_RETRY_NS
    k.hgt_timeout = 1 if now - k.hgt_pass > retry or height_lost(k, now) else 0


@kernel
def _reset_height(k: Any, p: Any, now: int, noise: float, armed: bool) -> None:
    """Reset the height to the barometer; the climb rate to GNSS's in flight, to zero on the ground."""
    k.shift_pos[2] += k.baro - (k.pos[2] - k.slack_pos[2])
    k.moved_pos[2] += k.baro - k.pos[2]
    k.pos[2] = k.baro
    k.slack_pos[2] = 0.0
    climb = k.vel[2]
    if not armed:
        climb = 0.0
    elif now - k.fix_at < _FRESH_NS:
        climb = k.gnss_vel[2]
    k.shift_vel[2] += climb - (k.vel[2] - k.slack_vel[2])
    k.moved_vel[2] += climb - k.vel[2]
    k.vel[2] = climb
    k.slack_vel[2] = 0.0
    u = k.up
    u[0], u[1], u[2], u[4] = noise, 0.0, 0.0, 0.0
    u[3] = p.EK3_VELD_M_NSE * p.EK3_VELD_M_NSE
    k.hgt_timeout = 0
    k.hgt_pass = now
    k.hgt_test = 0.0
    k.hgt_off = 0.0
    k.news |= _HEIGHT


@kernel
def _fuse_rest(e: Any, k: Any, p: Any, armed: bool) -> None:
    """Without aiding, fuse the last known position, with noise EK3_NOAID_M_NSE, which keeps tilt from drifting."""
    noise = clamp(p.EK3_NOAID_M_NSE, 0.5, 50.0) if armed else _REST_NOISE_M
    c = k.level
    east = k.held[0] - k.pos[0]
    north = k.held[1] - k.pos[1]
    correct_level(e, k, take_level(c, c[0], c[1], c[2], c[3], c[0] + noise * noise), east, north)
