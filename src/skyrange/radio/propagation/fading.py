"""Random parts of path loss: shadowing by position and fast fading by time, reciprocal and addressed.

Shadowing is what building maps leave out: log-normal, with the standard deviation that 3GPP TR 36.777 table B-3 gives
for aircraft above streets (UMi-AV): max(5·exp(−0.01·h), 2) dB in line of sight, h being the lower antenna's height,
and 8 dB without line of sight. Space is divided into cells; the value of a pair holds while neither end leaves its
cell. Moving one end by Δ keeps a share 1 − Δ/side of the values, so with a side of decorrelation distance/0.63 the
correlation falls to 1/e at the decorrelation distance: 10 m with, 13 m without line of sight (TR 38.901 table 7.5-6,
UMi).

Fading is Rician with line of sight, K = 12 dB (air to ground, near urban, 970 MHz: Matolak & Sun, IEEE Trans. Veh.
Tech. 66/1, 2017), and Rayleigh without. It holds for a time bin, whose length is the largest power of two of
nanoseconds within the coherence time 0.423·λ/v (Rappaport, "Wireless Communications", 5.40c). v is the speed between
both ends and at least 0.5 m/s, for the things that move in a street.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from skyrange.core import elementary
from skyrange.core.chance import uniform4
from skyrange.core.compiled import compiled
from skyrange.core.ids import hash64

LOS_DECORRELATION_M: Final = 10.0
NLOS_DECORRELATION_M: Final = 13.0
NLOS_SIGMA_DB: Final = 8.0
RICIAN_K: Final = 15.85
MIN_SPEED_MPS: Final = 0.5
_CELL: Final = 0.63
_SHADOW: Final = np.uint64(hash64("radio.shadow"))
_FADE: Final = np.uint64(hash64("radio.fade"))
_MIX: Final = np.uint64(0x9E3779B97F4A7C15)


@compiled
def pair_of(a: np.uint64, b: np.uint64) -> np.uint64:
    """The address of a pair of radios, the same from both ends."""
    return ((a ^ b) * _MIX) ^ (a + b)


@compiled
def directed_pair_of(sender: np.uint64, receiver: np.uint64) -> np.uint64:
    """The address of one direction between two radios."""
    return (sender * _MIX) ^ receiver


@compiled
def cell_of(x: float, y: float, z: float, side: float) -> np.uint64:
    """The address of the cell that holds a position."""
    bits = (math.floor(x / side) & 0x1FFFFF) | ((math.floor(y / side) & 0x1FFFFF) << 21)
    return np.uint64(bits | ((math.floor(z / side) & 0x1FFFFF) << 42))


@compiled
def standard_normal(u: float, v: float) -> float:
    """A standard normal number from two uniform ones (Box & Muller, 1958)."""
    return math.sqrt(-2.0 * elementary.log(1.0 - u)) * elementary.cos(2.0 * math.pi * v)


@compiled
def shadow_db(
    seed: np.uint64,
    pair: np.uint64,
    low_cell: np.uint64,
    high_cell: np.uint64,
    lower_height_m: float,
    hidden: bool,  # noqa: FBT001
) -> float:
    """Shadowing of a pair whose ends are in two cells; the first cell is that of the radio with the lower hash."""
    sigma = NLOS_SIGMA_DB if hidden else max(5.0 * elementary.exp(-0.01 * lower_height_m), 2.0)
    u, v, _, _ = uniform4(seed, _SHADOW, np.uint64(pair), np.uint64(low_cell), np.uint64(high_cell))
    return sigma * standard_normal(u, v)


@compiled
def cell_side_m(hidden: bool) -> float:  # noqa: FBT001
    """Side of a shadowing cell in metres."""
    return (NLOS_DECORRELATION_M if hidden else LOS_DECORRELATION_M) / _CELL


@compiled
def coherence_ns(speed_mps: float, wavelength: float) -> int:
    """Length of a fading bin in nanoseconds."""
    exact = 0.423 * wavelength / max(speed_mps, MIN_SPEED_MPS) * 1e9
    _, exponent = math.frexp(exact)
    return 1 << (exponent - 1)


@compiled
def fade_draws(seed: np.uint64, pair: np.uint64, time_ns: int, bin_ns: int, centre_mhz: float) -> tuple[float, float]:
    """Two random numbers of a pair at a time on a frequency: an exponential one of mean 1 and a uniform one."""
    when = np.uint64((time_ns // bin_ns) * bin_ns)
    u, v, _, _ = uniform4(seed, _FADE, np.uint64(pair), when, np.uint64(centre_mhz))
    return -elementary.log(1.0 - u), v


@compiled
def fade_db(draws: tuple[float, float], hidden: bool) -> float:  # noqa: FBT001
    """Fading in dB from its `fade_draws`; its mean power is 1."""
    power, turn = draws
    if not hidden:
        radius = math.sqrt(power / (RICIAN_K + 1.0))
        x = math.sqrt(RICIAN_K / (RICIAN_K + 1.0)) + radius * elementary.cos(2.0 * math.pi * turn)
        y = radius * elementary.sin(2.0 * math.pi * turn)
        power = x * x + y * y
    return 10.0 * elementary.log10(max(power, 1e-9))
