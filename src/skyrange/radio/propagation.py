"""How much of a signal arrives over open ground, behind an edge, from an antenna? Loss and gain in dB, no chance."""

from __future__ import annotations

import math
from typing import Final

from skyrange.core.compiled import kernel

SPEED_OF_LIGHT_MPS: Final = 299_792_458.0
NEAREST_M: Final = 0.5
"""Antennas are not nearer than this to each other: closer, far-field formulas end."""
LEAST_HEIGHT_M: Final = 0.5
"""An antenna lower than this reflects as if it were here."""
NULL_DB: Final = -20.0
"""Of a dipole towards its ends: a real one's feed and mount fill the null."""
NO_EDGE: Final = -0.78
"""Below this ν, an edge costs nothing."""
THERMAL_DBM_PER_MHZ: Final = -113.98
"""k·290 K·1 MHz."""


@kernel
def wavelength_m(frequency_mhz: float) -> float:
    """Of a frequency."""
    return SPEED_OF_LIGHT_MPS / (frequency_mhz * 1e6)


@kernel
def free_space_db(distance_m: float, wavelength: float) -> float:
    """Basic transmission loss in free space, 20·log10(4πd/λ) (ITU-R P.525-4, eq. 3)."""
    return 20.0 * math.log10(4.0 * math.pi * max(distance_m, NEAREST_M) / wavelength)


@kernel
def open_db(distance_m: float, height_a_m: float, height_b_m: float, wavelength: float) -> float:
    """Median loss over ground with nothing between: free space as far as 4·h1·h2/λ, 40 dB a decade beyond.

    ITU-R P.1411-12 4.1.1 (line of sight in the street, UHF): its median L_bp + 6 + 20·log10(d/R_bp), or 40·log10
    beyond R_bp; this is the envelope of a direct and a ground-reflected ray. High up, R_bp is out of reach.
    """
    breakpoint_m = 4.0 * max(height_a_m, LEAST_HEIGHT_M) * max(height_b_m, LEAST_HEIGHT_M) / wavelength
    loss = free_space_db(distance_m, wavelength)
    if distance_m > breakpoint_m:
        loss += 20.0 * math.log10(distance_m / breakpoint_m)
    return loss


@kernel
def edge_db(nu: float) -> float:
    """Loss J(ν) behind a knife edge (ITU-R P.526-15, eq. 31), 0 where ν is below -0.78."""
    if nu <= NO_EDGE:
        return 0.0
    return 6.9 + 20.0 * math.log10(math.sqrt((nu - 0.1) * (nu - 0.1) + 1.0) + nu - 0.1)


@kernel
def bullington_nu(slope_a: float, slope_b: float, distance_m: float, wavelength: float) -> float:
    """ν of the one edge that stands for many: where the steepest lines from both ends meet (P.526-15 4.5.1).

    Slopes are of those lines against the direct one. The lines meet h = d·a·b/(a+b) off it, b/(a+b) of the way along;
    so ν = h·√(2d/λd1d2) = √(2·d·a·b/λ). It never falls when another edge is added.
    """
    if slope_a <= 0.0 or slope_b <= 0.0:
        return 0.0
    return math.sqrt(2.0 * distance_m * slope_a * slope_b / wavelength)


@kernel
def dipole_dbi(sine_of_elevation: float) -> float:
    """Gain of a vertical half-wave dipole, 2.15 dBi level (Balanis, "Antenna Theory", 4-84), not below `NULL_DB`."""
    level = 1.0 - sine_of_elevation * sine_of_elevation
    if level <= 1e-9:
        return NULL_DB
    field = math.cos(0.5 * math.pi * sine_of_elevation)
    return max(2.15 + 10.0 * math.log10(max(field * field / level, 1e-9)), NULL_DB)


@kernel
def noise_dbm(noise_figure_db: float, width_mhz: float) -> float:
    """Thermal noise of a receiver at 290 K."""
    return THERMAL_DBM_PER_MHZ + noise_figure_db + 10.0 * math.log10(width_mhz)
