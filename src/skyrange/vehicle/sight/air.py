"""Estimate of the air before a sensor: the thickest rain, fog or dirt that the returns of the map do not contradict.

A companion that takes the air to be clear disbelieves real aircraft in fog, because nothing returns from them. What
returns from surfaces of its map tells how far light comes. The companion does not know their materials, so it takes
each to be as bright as white masonry: an extinction is contradicted if even then fewer pulses would have returned than
did. Let n be the pulses that returned from the map, and m the number that the extinction lets expect at most. Counts
of rare events reach n with a probability of at most exp(m - n) · (m / n)^n if n is above m (the bound of Chernoff for
a Poisson variable), and an extinction is contradicted below the allowed rate of error.

Where no surface of the map is in the field, nothing is contradicted, and the companion cannot look. The air is taken
to be the same everywhere before a sensor, and surfaces to be no brighter than white masonry: a retroreflector in a
wall makes air seem clearer than it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from skyrange.core import elementary, elementary_python
from skyrange.core.arrays import Floats
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S, Time
from skyrange.optics.ray_index import RayIndex
from skyrange.optics.returns import make_detector
from skyrange.optics.sensor_models import LidarModel
from skyrange.vehicle.sight.beams import WALL_M, Beams, SensorView, find_map_hits
from skyrange.vehicle.sight.settings import Air

CLEAR: Final = (0.0,)
"""The only extinction of a companion that takes the air to be clear."""
EXTINCTIONS: Final = (
    *(0.0, 0.001, 0.002, 0.003, 0.004, 0.005, 0.006, 0.007, 0.008, 0.0095, 0.011, 0.013, 0.016, 0.02, 0.025, 0.032),
    *(0.045, 0.064, 0.09, 0.128, 0.18, 0.256, math.inf),
)
"""Extinction coefficients in 1/m among which the estimate chooses: from clear air to fog with a visibility of 15 m; the
last is a sensor that returns nothing."""
BRIGHTEST: Final = 0.85
"""Reflectivity of white masonry at 0.9 µm (Wehr & Lohr, ISPRS J. Photogramm. Remote Sens. 54, 1999)."""
PART_NS: Final[Time] = 2 * NS_PER_S
"""Returns of this part of time and of the one before it count (assumed: weather changes in no less)."""
_SAMPLE: Final = 2_048
"""About so many pulses of a scan are compared with the map."""


def list_extinctions(air: Air) -> Sequence[float]:
    """The extinctions in 1/m that a setting thinks possible."""
    return EXTINCTIONS if air == "estimated" else CLEAR


class AirEstimate:
    """What the returns of the map say of the air before one sensor. Deep copies continue alike."""

    __slots__ = ("_extinctions", "_last", "_missed", "_part", "_this")

    def __init__(self, extinctions: Sequence[float], missed: float) -> None:
        """`extinctions` rise; `missed` is the probability with which the true one may be contradicted."""
        self._extinctions = np.array(extinctions)
        self._missed = missed
        self._part = 0
        self._last = np.zeros(len(extinctions) + 1)
        """In the part of time before: by extinction, the most pulses that it lets expect; then those that returned."""
        self._this = np.zeros(len(extinctions) + 1)
        """The same, in this part."""

    def update(self, now: Time, view: SensorView, beams: Beams, city: RayIndex) -> None:
        """Take in a scan. Scans of depth cameras contradict nothing."""
        model = view.sensor.model
        if len(self._extinctions) == 1 or not isinstance(model, LidarModel):
            return
        part = now // PART_NS
        if part != self._part:
            self._last = self._this if part == self._part + 1 else np.zeros(len(self._this))
            self._part, self._this = part, np.zeros(len(self._this))
        rows = np.arange(0, len(beams.distance_m), max(len(beams.distance_m) // _SAMPLE, 1) | 1)
        mapped, cosine = find_map_hits(city, beams, rows, model.reach_m)
        measured = beams.distance_m[rows]
        counts = (mapped >= model.near_m) & (mapped < math.inf)
        beside = np.where(counts & (measured > 0.0), measured - mapped, 0.0) * cosine
        counts &= beside >= -WALL_M  # what is nearer hides the map
        self._this[-1] += float(np.count_nonzero(counts & (measured > 0.0) & (beside <= WALL_M)))
        detector = make_detector(model)
        reference = detector.reference / model.reference_reflectivity * model.reference_m * model.reference_m
        noise = view.false_alarm_per_m * 2.0 * WALL_M
        _add_expected(
            mapped[counts],
            cosine[counts],
            self._extinctions,
            BRIGHTEST * reference,
            detector.threshold,
            noise,
            self._this,
        )

    def count_allowed(self) -> int:
        """How many of the extinctions, from the first on, are not contradicted; at least one."""
        *most, returned = (self._last + self._this).tolist()
        for number, expected in enumerate(most):
            if number and returned > expected:
                surprise = expected - returned
                if expected > 0.0:
                    surprise += returned * elementary_python.log(returned / expected)
                else:
                    surprise = math.inf
                if surprise >= -elementary_python.log(self._missed):
                    return number
        return len(self._extinctions)


@compiled
def _add_expected(  # noqa: PLR0917
    mapped: Floats,
    cosine: Floats,
    extinctions: Floats,
    brightest: float,
    threshold: float,
    noise_per_m: float,
    expected: Floats,
) -> None:
    """Add, for each extinction, the probability that each pulse returns from the brightest surface, or by noise."""
    false_alarm = 0.5 * elementary.erfc(threshold * math.sqrt(0.5))
    for i in range(mapped.shape[0]):
        amplitude = brightest * cosine[i] / (mapped[i] * mapped[i])
        noise = noise_per_m / max(cosine[i], 1e-3)
        found = 1.0
        for k in range(extinctions.shape[0]):
            if found > 0.0:  # otherwise it is 0 through thicker air, too
                left = amplitude * elementary.exp(-2.0 * extinctions[k] * mapped[i])
                found = 0.0
                if left > threshold + 6.0:
                    found = 1.0
                elif left > 1e-3:
                    found = 0.5 * elementary.erfc((threshold - left) * math.sqrt(0.5)) - false_alarm
            expected[k] += min(found + noise, 1.0)
