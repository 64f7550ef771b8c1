"""Deterministic propagation: path loss over open ground, knife-edge diffraction, antenna gain and thermal noise."""

from __future__ import annotations

import math
from typing import Final

from skyrange.core import elementary
from skyrange.core.compiled import compiled

SPEED_OF_LIGHT_MPS: Final = 299_792_458.0
MIN_DISTANCE_M: Final = 0.5
"""The shortest distance between antennas: the far-field formulas do not hold below it."""
MIN_HEIGHT_M: Final = 0.5
"""Ground reflection is computed for at least this antenna height."""
NULL_DB: Final = -20.0
"""Gain of a dipole along its axis: the feed and mount of a real one fill the null."""
CLEAR_NU: Final = -0.78
"""Below this ν, an edge causes no loss."""
THERMAL_DBM_PER_MHZ: Final = -113.98
"""k·290 K·1 MHz."""


@compiled
def wavelength_m(frequency_mhz: float) -> float:
    """Wavelength in metres of a frequency in MHz."""
    return SPEED_OF_LIGHT_MPS / (frequency_mhz * 1e6)


@compiled
def free_space_db(distance_m: float, wavelength: float) -> float:
    """Basic transmission loss in free space, 20·log10(4πd/λ) (ITU-R P.525-4, eq. 3)."""
    return 20.0 * elementary.log10(4.0 * math.pi * max(distance_m, MIN_DISTANCE_M) / wavelength)


@compiled
def ground_excess_db(distance_m: float, height_a_m: float, height_b_m: float, wavelength: float) -> float:
    """Loss over unobstructed ground on top of free space: 0 up to the distance 4·h1·h2/λ, 20 dB per decade beyond."""
    breakpoint_m = 4.0 * max(height_a_m, MIN_HEIGHT_M) * max(height_b_m, MIN_HEIGHT_M) / wavelength
    return 20.0 * elementary.log10(distance_m / breakpoint_m) if distance_m > breakpoint_m else 0.0


@compiled
def open_ground_db(distance_m: float, height_a_m: float, height_b_m: float, wavelength: float) -> float:
    """Median loss over unobstructed ground: free space up to the distance 4·h1·h2/λ, 40 dB per decade beyond.

    ITU-R P.1411-12 4.1.2 (site-specific, line of sight, UHF; 4.3.2.1 has the same between terminals 1.5 to 4 m high):
    its median L_bp + 6 + 20·log10(d/R_bp), or 40·log10 beyond R_bp; this is the envelope of a direct and a
    ground-reflected ray. High up, R_bp is beyond the range.
    """
    return free_space_db(distance_m, wavelength) + ground_excess_db(distance_m, height_a_m, height_b_m, wavelength)


@compiled
def knife_edge_db(nu: float) -> float:
    """Loss J(ν) behind a knife edge (ITU-R P.526-15, eq. 31), 0 where ν is below -0.78."""
    if nu <= CLEAR_NU:
        return 0.0
    return 6.9 + 20.0 * elementary.log10(math.sqrt((nu - 0.1) * (nu - 0.1) + 1.0) + nu - 0.1)


@compiled
def bullington_nu(slope_a: float, slope_b: float, distance_m: float, wavelength: float) -> float:
    """ν of the single edge equivalent to many: where the steepest lines from both ends meet (P.526-15 4.5.1).

    Slopes are those of these lines against the direct one. The lines meet at a height h = d·a·b/(a+b) above it, at
    b/(a+b) of the distance; so ν = h·√(2d/λd1d2) = √(2·d·a·b/λ). It never falls when another edge is added.
    """
    if slope_a <= 0.0 or slope_b <= 0.0:
        return 0.0
    return math.sqrt(2.0 * distance_m * slope_a * slope_b / wavelength)


@compiled
def dipole_dbi(sine_of_elevation: float) -> float:
    """Gain of a vertical half-wave dipole, 2.15 dBi horizontally (Balanis, "Antenna Theory", 4-84), at least
    `NULL_DB`.
    """
    level = 1.0 - sine_of_elevation * sine_of_elevation
    if level <= 1e-9:
        return NULL_DB
    field = elementary.cos(0.5 * math.pi * sine_of_elevation)
    return max(2.15 + 10.0 * elementary.log10(max(field * field / level, 1e-9)), NULL_DB)


@compiled
def noise_dbm(noise_figure_db: float, width_mhz: float) -> float:
    """Thermal noise of a receiver at 290 K."""
    return THERMAL_DBM_PER_MHZ + noise_figure_db + 10.0 * elementary.log10(width_mhz)
