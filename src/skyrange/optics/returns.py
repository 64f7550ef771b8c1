"""Returns of a LiDAR: which pulses come back, and with which distance.

A pulse lights a footprint, which is sampled by rays. Those that meet one surface add up to an echo; the strongest echo
counts. The power of an echo is that of a Lambertian surface that the beam lights with part of its power: reflectivity ·
cosine of incidence · part of the beam · exp(-2 · extinction · distance) / distance² (the range equation for an extended
target: Wagner et al., ISPRS J. Photogramm. Remote Sens. 60, 2006). The detector has Gaussian noise and a threshold:
noise alone crosses it with the probability of a false alarm, and an echo of the reference's power with the probability
that the model states, so both fix threshold and noise (as in Richmond & Cain, "Direct-Detection LADAR Systems", SPIE
2010). An echo may be as weak as it likes: it is then returned seldom, not never.

Chance is addressed by pulse: sensor, time of the pulse, and its number in the scan.

Not modelled: several echoes of one pulse, light of the sun and of other sensors, light that a wall reflects further,
and echoes of two surfaces that merge.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core import elementary, elementary_python
from skyrange.core.arrays import Floats
from skyrange.core.chance import Chance, uniform4
from skyrange.core.compiled import compiled
from skyrange.core.errors import InputError
from skyrange.core.ids import hash64
from skyrange.optics.extinction import Weather, find_extinction
from skyrange.optics.ray_casting import BUILDING, GROUND, NONE, Hits
from skyrange.optics.reflectivity import Surfaces
from skyrange.optics.scan_patterns import Firing
from skyrange.optics.sensor_models import LidarModel

STREAM: Final = "optics.lidar"
MAX_STEPS: Final = 65_535
"""The largest distance that can be reported, in steps of the model's resolution; 0 is no return."""


class Address(NamedTuple):
    """Where the chance of a scan is addressed."""

    chance: Chance
    who: int
    """The sensor (`core.ids.hash64` of its name)."""
    start_ns: int
    """Time of the start of the scan."""

    def key(self, stream: str) -> tuple[np.uint64, np.uint64, np.uint64]:
        """What compiled functions draw with, besides the time and the number of the draw."""
        return self.chance.key, np.uint64(hash64(stream)), np.uint64(self.who)


class Returns(NamedTuple):
    """What a LiDAR reports of the n pulses of one scan, and what is true of each."""

    steps: NDArray[np.uint16]
    """(n,): distance in steps of the model's resolution, 0 for no return."""
    signal: Floats
    """(n,): power of the strongest echo over that of the reference; 0 without an echo."""
    kind: NDArray[np.uint8]
    """(n,): truth, of what the strongest echo is (`Hits.kind`), whether it is returned or not."""
    row: NDArray[np.int32]
    """(n,): truth, its row (`Hits.row`)."""
    is_false: NDArray[np.bool_]
    """(n,): truth, that the distance is noise."""


class Detector(NamedTuple):
    """The detector of a model: noise has the standard deviation 1."""

    threshold: float
    reference: float
    """Amplitude of the reference's echo."""


@lru_cache(maxsize=64)
def make_detector(model: LidarModel) -> Detector:
    """The threshold and the amplitude that the probabilities of a model mean.

    Raises `InputError` for probabilities that no detector has.
    """
    for name in ("false_alarm", "reference_probability"):
        if not 0.0 < getattr(model, name) < 1.0:
            raise InputError.one(model.name, name, repr(getattr(model, name)), "a probability above 0 and below 1")
    if model.reach_m > MAX_STEPS * model.resolution_m:
        most = MAX_STEPS * model.resolution_m
        raise InputError.one(model.name, "reach_m", repr(model.reach_m), f"at most {most:g} m, what 16 bits hold")
    threshold = _find_quantile(model.false_alarm)
    return Detector(threshold, threshold - _find_quantile(model.reference_probability))


def _find_quantile(above: float) -> float:
    """The number that a standard normal variable exceeds with the probability `above`, by bisection."""
    low, high = -40.0, 40.0
    for _ in range(100):
        middle = 0.5 * (low + high)
        if 0.5 * elementary_python.erfc(middle * math.sqrt(0.5)) > above:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def find_returns(
    model: LidarModel, firing: Firing, hits: Hits, surfaces: Surfaces, weather: Weather, address: Address
) -> Returns:
    """The returns of n pulses, each of which `hits` samples with the same number of rays, pulse by pulse.

    Raises `InputError` for a number of rays that is no multiple of the number of pulses.
    """
    count = len(firing.delay_s)
    if count == 0 or len(hits.kind) % count:
        raise InputError.one(model.name, "hits", str(len(hits.kind)), f"a multiple of the {count} pulses")
    detector = make_detector(model)
    extinction = find_extinction(weather, model.wavelength_um)
    times = np.asarray(address.start_ns + np.rint(firing.delay_s * 1e9).astype(np.int64)).view(np.uint64)
    returns = Returns(
        np.zeros(count, dtype=np.uint16),
        np.zeros(count),
        np.zeros(count, dtype=np.uint8),
        np.full(count, -1, dtype=np.int32),
        np.zeros(count, dtype=np.bool_),
    )
    limits = (model.near_m, model.reach_m, model.noise_m, model.rise_m, model.resolution_m)
    odds = (model.false_alarm, model.drop_out, model.reference_reflectivity / (model.reference_m * model.reference_m))
    key = address.key(STREAM)
    _find(hits, surfaces, extinction, detector, limits, odds, key, times, firing.number, returns)
    return returns


@compiled
def _find(  # noqa: PLR0917
    hits: Hits,
    surfaces: Surfaces,
    extinction: float,
    detector: Detector,
    limits: tuple[float, float, float, float, float],
    odds: tuple[float, float, float],
    key: tuple[np.uint64, np.uint64, np.uint64],
    times: NDArray[np.uint64],
    numbers: NDArray[np.uint64],
    returns: Returns,
) -> None:
    near, reach, noise, rise, resolution = limits
    false_alarm, drop_out, reference = odds
    count = returns.steps.shape[0]
    samples = hits.kind.shape[0] // count
    power, away = np.empty(samples), np.empty(samples)
    for i in range(count):
        begin = i * samples
        best = -1
        for k in range(samples):
            j = begin + k
            power[k] = away[k] = 0.0
            if hits.kind[j] == NONE or hits.distance_m[j] < near:
                continue
            if hits.kind[j] == GROUND:
                reflectivity = surfaces.ground
            elif hits.kind[j] == BUILDING:
                reflectivity = surfaces.building[hits.row[j] % surfaces.building.shape[0]]
            else:
                reflectivity = surfaces.aircraft[hits.row[j] % surfaces.aircraft.shape[0]]
            distance = hits.distance_m[j]
            echo = reflectivity * hits.cosine[j]
            if extinction > 0.0:
                echo *= elementary.exp(-2.0 * extinction * distance)
            echo = echo / (distance * distance * samples * reference)
            first = k  # the first ray that meets the same surface collects its echo
            for other in range(k):
                alike = hits.kind[begin + other] == hits.kind[j] and hits.row[begin + other] == hits.row[j]
                if alike and hits.distance_m[begin + other] >= near:
                    first = other
                    break
            power[first] += echo
            away[first] += echo * distance
            if best < 0 or power[first] > power[best]:
                best = first
        u0, u1, u2, u3 = uniform4(key[0], key[1], key[2], times[i], numbers[i])
        signal = 0.0
        if best >= 0 and power[best] > 0.0:
            signal = power[best]
            returns.kind[i] = hits.kind[begin + best]
            returns.row[i] = hits.row[begin + best]
        returns.signal[i] = signal
        if u3 < drop_out:
            continue
        if u2 < false_alarm:  # noise comes first
            measured = near + u0 * (reach - near)
            returns.is_false[i] = True
        else:
            if signal == 0.0:
                continue
            amplitude = signal * detector.reference
            if u2 >= 0.5 * elementary.erfc((detector.threshold - amplitude) * math.sqrt(0.5)):
                continue
            spread = rise / max(amplitude, detector.threshold)
            normal = math.sqrt(-2.0 * elementary.log(1.0 - u0)) * elementary.cos(2.0 * math.pi * u1)
            measured = away[best] / power[best] + math.sqrt(noise * noise + spread * spread) * normal
            if not near <= measured <= reach:
                continue
        returns.steps[i] = np.uint16(math.floor(measured / resolution + 0.5))
