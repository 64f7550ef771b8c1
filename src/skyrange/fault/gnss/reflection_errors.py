"""Errors of GNSS fixes among buildings: satellites that are hidden, or received by reflections."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Final

import numpy as np

from skyrange.attack.gnss.receiver_noise import CHIP_M
from skyrange.city.city import City
from skyrange.contracts.components import Floats
from skyrange.fault.sky_view import Satellite, Seen, see, solve

WAVE_M: Final = 0.190293673
"""Wavelength of GPS L1, 1575.42 MHz (IS-GPS-200)."""


@dataclass(frozen=True, slots=True)
class ReflectionModel:
    """The buildings, and a receiver among them."""

    city: City
    reflection: float
    """Amplitude of a reflected signal, as a share of the direct one's."""
    spacing_chips: float
    """Spacing of the receiver's correlators in C/A chips."""
    radius_m: float
    """Distance up to which buildings count."""

    def degrade(
        self, place: tuple[float, float, float], hemisphere: tuple[Satellite, ...]
    ) -> tuple[int, tuple[Floats, tuple[float, float]] | None]:
        """What the receiver makes of satellites at a place.

        Returns how many it receives, and of its fix the offset in metres with the factors of horizontal and vertical
        dilution against the open sky; `None` without a fix.
        """
        seen, count = see(self.city, place, hemisphere, self.radius_m), len(hemisphere)
        errors_m = pseudorange_errors(seen, self.reflection, self.spacing_chips)
        strength = np.where(seen.hidden > 0.0, self.reflection, 1.0)
        solved, open_sky = solve(hemisphere, errors_m, strength), solve(hemisphere, np.zeros(count), np.ones(count))
        received = int(np.isfinite(errors_m).sum())
        if solved is None or open_sky is None:
            return received, None
        offset_m, dilution = solved
        flat = float(np.hypot(*dilution[:2]) / np.hypot(*open_sky[1][:2]))
        return received, (offset_m, (flat, float(dilution[2] / open_sky[1][2])))


def pseudorange_errors(seen: Seen, reflection: float, spacing_chips: float) -> Floats:
    """Errors (n,) in metres of the pseudoranges; NaN for a satellite that is hidden and not reflected.

    A hidden satellite has the whole detour of its reflection. One in sight has the error of a reflection that a delay
    lock loop does not resolve: ±(α·detour) for a short one, and at most α·spacing·chip/2, 7 m for half the amplitude
    and a tenth of a chip (Van Dierendonck, Fenton and Ford, Theory and performance of narrow correlator spacing in a
    GPS receiver, Navigation 39:3, 1992). Its sign and size follow the phase of the detour. Reflections that are longer
    than a chip and a half do no harm.
    """
    detour = seen.detour_m
    most_m = reflection * spacing_chips * CHIP_M / 2.0
    mixed = np.minimum(reflection * detour, most_m) * np.cos(2.0 * pi * detour / WAVE_M)
    mixed = np.where(np.isnan(detour) | (detour > 1.5 * CHIP_M), 0.0, mixed)
    return np.asarray(np.where(seen.hidden > 0.0, detour, mixed), dtype=np.float64)
