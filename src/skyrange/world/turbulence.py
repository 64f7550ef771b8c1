"""Dryden turbulence at low altitude, one numba kernel over all aircraft.

MIL-F-8785C, 3.7.1.2 (Dryden form) with the low-altitude model of 3.7.3.4; MIL-HDBK-1797 has the same model with half
the lateral and vertical scale lengths written into its spectra. With h in feet, held in 10…1000:

    σ_w = 0.1·W20        σ_u = σ_v = σ_w / (0.177 + 0.000823·h)^0.4
    L_w = h              L_u = L_v = h / (0.177 + 0.000823·h)^1.2
    H_u = σ·√(2L/πV) / (1 + (L/V)s)        H_v, H_w = σ·√(L/πV)·(1 + √3·(L/V)s) / (1 + (L/V)s)²

With T = L/V the autocorrelations are σ²·e^(-t/T) along, and σ²·e^(-t/T)·(1 - t/2T) across and up.

**Speed.** The filters turn variation in space into variation in time by the speed V at which an aircraft passes
through it, and stand still at V = 0. Here V is the speed through the mean air, and at least the turbulent velocity
σ_u: eddies of size L moving at σ turn over in L/σ (Tennekes & Lumley, "A First Course in Turbulence", 1972, 1.5)
whether an aircraft moves through them or not. In a hover in a mean wind, V is that wind.

**Axes.** u along the steady wind (east in none), v to its left, w up. The standard has u along the relative wind,
which for a multirotor would turn the gusts whenever it changes direction; the two horizontal components differ only in
the shape of their spectrum.

**Steps.** Every 20 ms, held in between: 0.3 m at 15 m/s, so less than the aircraft's size, over which finer gusts
average out. Each step is exact for the filter at that speed and height (its state's transition and covariance in
closed form), so the samples have the right variance and correlation at any step.

Each aircraft has its own turbulence: two that fly side by side meet unrelated gusts. A street canyon is not modelled:
neither its channelled wind nor the wakes of its buildings.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core import elementary
from skyrange.core.chance import philox
from skyrange.core.compiled import compiled

Floats = NDArray[np.float64]
Words = NDArray[np.uint64]

GUST_NS = 20_000_000
"""Interval at which the gusts change."""
STREAM = "world.turbulence"
STATES = 5
"""Filter states of an aircraft: u; first and second of v; first and second of w. The firsts have unit variance."""

_FEET = 1.0 / 0.3048
_LOWEST_FT, _HIGHEST_FT = 10.0, 1000.0
_32 = np.uint64(32)
_LOW = np.uint64(0xFFFFFFFF)
_UNIT = 1.0 / 4294967296.0
_ZERO = np.uint64(0)
_ROOT3 = math.sqrt(3.0)
_PER_ROOT2 = math.sqrt(0.5)


@compiled
def scales(height_m: float, w20_mps: float) -> tuple[float, float, float, float]:
    """σ_u = σ_v and σ_w in m/s, L_u = L_v and L_w in metres, at a height above the ground."""
    feet = min(max(height_m * _FEET, _LOWEST_FT), _HIGHEST_FT)
    base = 0.177 + 0.000823 * feet
    stretch = elementary.power(base, 0.4)
    sigma_w = 0.1 * w20_mps
    return sigma_w / stretch, sigma_w, feet / (stretch * stretch * stretch * _FEET), feet / _FEET


@compiled
def _normal_pair(word: np.uint64) -> tuple[float, float]:
    """Two independent standard normals from one random word (Box & Muller 1958), within 6.7 sigma."""
    radius = math.sqrt(-2.0 * elementary.log(((word >> _32) + 1.0) * _UNIT))
    angle = 2.0 * math.pi * ((word & _LOW) * _UNIT)
    return radius * elementary.cos(angle), radius * elementary.sin(angle)


@compiled
def _step_chain(first: float, second: float, a: float, d: float, n1: float, n2: float) -> tuple[float, float]:
    """One exact step of the chain T·p' = -p + noise, T·q' = -q + p with unit variance of p.

    `a` is e^-d, `d` the step over T. In steady state var q = cov(p, q) = 1/2; the covariance that the transition does
    not preserve is the noise of the step, here by its Cholesky factor.
    """
    aa = a * a
    q11 = -elementary.expm1(-2.0 * d)
    q12 = 0.5 - aa * (d + 0.5)
    q22 = 0.5 - aa * (0.5 + d + d * d)
    l11 = math.sqrt(q11)
    l21 = q12 / l11
    l22 = math.sqrt(max(q22 - l21 * l21, 0.0))
    return a * first + l11 * n1, a * (second + d * first) + l21 * n1 + l22 * n2


class Gusts(NamedTuple):
    """The gusts of n aircraft, and what they are drawn by."""

    seeds: Words
    """(n,) those of the aircraft's runs."""
    stream: np.uint64
    who: Words
    """(n,) their addresses in chance."""
    steady_enu_mps: Floats
    """(3,)."""
    w20_mps: float
    state: Floats
    """(n, 5) of the filters."""


@compiled
def gust(when: np.uint64, step_s: float, gusts: Gusts, velocity: Floats, height: Floats, air: Floats) -> None:
    """Step every aircraft's gusts by `step_s`, or draw their steady state if it is negative; writes the air's velocity.

    Shapes, n aircraft: `velocity` (n, 3), `height` (n,) above the floor, `air` (n, 3) east-north-up.
    """
    seeds, stream, who, steady_enu_mps, w20_mps, state = gusts
    start = step_s < 0.0
    mean = math.sqrt(steady_enu_mps[0] * steady_enu_mps[0] + steady_enu_mps[1] * steady_enu_mps[1])
    along_e, along_n = (steady_enu_mps[0] / mean, steady_enu_mps[1] / mean) if mean > 0.0 else (1.0, 0.0)
    for i in range(state.shape[0]):
        word0, word1, word2, _ = philox(seeds[i], stream, who[i], when, _ZERO, _ZERO)
        n0, n1 = _normal_pair(word0)
        n2, n3 = _normal_pair(word1)
        n4, _ = _normal_pair(word2)
        s = state[i]
        sigma, sigma_w, length, length_w = scales(height[i], w20_mps)
        if start:
            s[0] = n0
            s[1], s[2] = n1, 0.5 * n1 + 0.5 * n2  # var q = 1/2, cov = 1/2
            s[3], s[4] = n3, 0.5 * n3 + 0.5 * n4
        else:
            ue = velocity[i, 0] - steady_enu_mps[0]
            un = velocity[i, 1] - steady_enu_mps[1]
            uu = velocity[i, 2] - steady_enu_mps[2]
            speed = max(math.sqrt(ue * ue + un * un + uu * uu), sigma)
            d = step_s * speed / length
            a = elementary.exp(-d)
            s[0] = a * s[0] + math.sqrt(-elementary.expm1(-2.0 * d)) * n0
            s[1], s[2] = _step_chain(s[1], s[2], a, d, n1, n2)
            d = step_s * speed / length_w
            s[3], s[4] = _step_chain(s[3], s[4], elementary.exp(-d), d, n3, n4)
        # (1 + √3·T·s) applied to the second state of the chain has variance 2
        u = sigma * s[0]
        v = sigma * _PER_ROOT2 * (_ROOT3 * s[1] + (1.0 - _ROOT3) * s[2])
        air[i, 0] = steady_enu_mps[0] + along_e * u - along_n * v
        air[i, 1] = steady_enu_mps[1] + along_n * u + along_e * v
        air[i, 2] = steady_enu_mps[2] + sigma_w * _PER_ROOT2 * (_ROOT3 * s[3] + (1.0 - _ROOT3) * s[4])
