"""Addressed, counter-based chance: a random number is a function of (seed, stream, who, when, k).

No generator has state, so drawing one number never changes another. Philox4x64-10 of Salmon, Moraes, Dror & Shaw,
"Parallel random numbers: as easy as 1, 2, 3" (SC'11, doi 10.1145/2063384.2063405), table 2; the multipliers and Weyl
constants are theirs, and the output equals that of `numpy.random.Philox`. One compiled function serves compiled and
numpy callers alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.core.ids import hash64

_M0 = np.uint64(0xD2E7470EE14C6C93)
_M1 = np.uint64(0xCA5A826395121157)
_W0 = np.uint64(0x9E3779B97F4A7C15)
_W1 = np.uint64(0xBB67AE8584CAA73B)
_LOW = np.uint64(0xFFFFFFFF)
_32 = np.uint64(32)
_11 = np.uint64(11)
_UNIT = 1.0 / 9007199254740992.0  # 2**-53: the top 53 bits become a float in [0, 1)


@compiled
def _mulhi(a: np.uint64, b: np.uint64) -> np.uint64:
    """High 64 bits of the 128-bit product, by 32-bit halves."""
    a_lo = a & _LOW
    a_hi = a >> _32
    b_lo = b & _LOW
    b_hi = b >> _32
    low = a_lo * b_lo
    mid = a_hi * b_lo + (low >> _32)
    mid2 = a_lo * b_hi + (mid & _LOW)
    return a_hi * b_hi + (mid >> _32) + (mid2 >> _32)


@compiled
def philox(
    key0: np.uint64, key1: np.uint64, c0: np.uint64, c1: np.uint64, c2: np.uint64, c3: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """One Philox4x64-10 block: 2 key words and 4 counter words in, 4 random words out."""
    for _ in range(10):
        hi0 = _mulhi(_M0, c0)
        lo0 = _M0 * c0
        hi1 = _mulhi(_M1, c2)
        lo1 = _M1 * c2
        c0, c1, c2, c3 = hi1 ^ c1 ^ key0, lo1, hi0 ^ c3 ^ key1, lo0
        key0 = key0 + _W0
        key1 = key1 + _W1
    return c0, c1, c2, c3


@compiled
def uniform4(
    seed: np.uint64, stream: np.uint64, who: np.uint64, when: np.uint64, k: np.uint64
) -> tuple[float, float, float, float]:
    """Four independent uniforms in [0, 1) for one address; callable from Python and from compiled functions."""
    a, b, c, d = philox(seed, stream, who, when, k, np.uint64(0))
    return (
        (a >> _11) * _UNIT,
        (b >> _11) * _UNIT,
        (c >> _11) * _UNIT,
        (d >> _11) * _UNIT,
    )


@compiled
def _fill(
    seed: np.uint64,
    stream: np.uint64,
    who: NDArray[np.uint64],
    when: NDArray[np.uint64],
    k: NDArray[np.uint64],
    out: NDArray[np.float64],
) -> None:
    for i in range(who.shape[0]):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = uniform4(seed, stream, who[i], when[i], k[i])


class Chance:
    """A scenario's chance: the seed, with streams by name.

    Times may be negative (pre-roll); they enter the counter as two's complement.
    """

    __slots__ = ("key", "seed")

    def __init__(self, seed: int) -> None:
        """`seed` is any integer; its low 64 bits count."""
        self.seed = seed
        self.key = np.uint64(seed & 0xFFFFFFFFFFFFFFFF)
        """What compiled functions draw with."""

    def uniform4(self, stream: str, who: int, when: int, k: int = 0) -> tuple[float, float, float, float]:
        """Four uniforms in [0, 1) for (stream, who, when, k).

        `who` is a 64-bit address (see `hash64`), `when` is in nanoseconds, `k` is the index among draws that share all
        the rest.
        """
        return uniform4(
            self.key,
            np.uint64(hash64(stream)),
            np.uint64(who),
            np.uint64(when & 0xFFFFFFFFFFFFFFFF),
            np.uint64(k),
        )

    def uniforms(
        self, stream: str, who: NDArray[np.uint64], when: NDArray[np.int64], k: NDArray[np.uint64]
    ) -> NDArray[np.float64]:
        """The same for arrays of shape (n,): an (n, 4) array, equal to n scalar calls to the bit."""
        out = np.empty((who.shape[0], 4), dtype=np.float64)
        _fill(self.key, np.uint64(hash64(stream)), who, when.astype(np.int64).view(np.uint64), k, out)
        return out
