"""GNSS multipath: among buildings, satellites are hidden or received by reflections, and fixes have errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

import skyrange.plugin as sky
from skyrange.attack.bases.gnss.emitter import FIX_NONE
from skyrange.attack.bases.gnss.fixes import FIX_2D, UNALTERED
from skyrange.attack.bases.gnss.receiver_noise import CHIP_M, LEAST_SATELLITES
from skyrange.city.city import City
from skyrange.contracts.components import Floats
from skyrange.core import elementary_python, elementwise, matrices
from skyrange.core.elementary import asin, cos, sin, tan

Shapes = NDArray[np.object_]

LEAST_ELEVATION_RAD: Final = 0.17
"""Ten degrees: the elevation mask of usual receivers."""
MOST_CONDITION: Final = 1e6
"""Largest condition number of the normal equations: beyond it there is no fix."""
_GOLDEN_RAD: Final = pi * (3.0 - sqrt(5.0))


@dataclass(frozen=True, slots=True)
class Satellite:
    """A direction in the sky, radians; the azimuth is from east towards north."""

    azimuth_rad: float
    elevation_rad: float

    @property
    def unit(self) -> tuple[float, float, float]:
        """East, north and up of the direction."""
        flat = cos(self.elevation_rad)
        return flat * cos(self.azimuth_rad), flat * sin(self.azimuth_rad), sin(self.elevation_rad)


def even_sky(count: int, first_rad: float) -> tuple[Satellite, ...]:
    """Directions that share the sky above the mask evenly (a Fibonacci lattice), from an azimuth `first_rad` on."""
    lowest = sin(LEAST_ELEVATION_RAD)
    heights = [lowest + (1.0 - lowest) * (k + 0.5) / count for k in range(count)]
    return tuple(Satellite(first_rad + k * _GOLDEN_RAD, asin(height)) for k, height in enumerate(heights))


@dataclass(frozen=True, slots=True)
class Seen:
    """How the signals of n satellites reach an antenna."""

    hidden: Floats
    """(n,) 1 where a building blocks the line of sight, else 0."""
    detour_m: Floats
    """(n,) how much longer than the direct path the reflected one is; NaN where there is none."""


def see(city: City, place: tuple[float, float, float], sky: tuple[Satellite, ...], radius_m: float) -> Seen:
    """Direct and reflected paths from each satellite to `place`, by buildings within `radius_m`.

    A satellite is hidden by a building in its azimuth that is higher than the ray there. A wall in the opposite azimuth
    reflects it if it is high enough where the reflected ray meets it, and if the ray reaches it. The detour of a
    reflection by a vertical wall at a distance d across the ray is 2·d·cos(elevation) (Hsu, Analysis and modeling GPS
    NLOS effect in highly urbanized area, GPS Solutions 22:7, 2018). Walls are taken to stand across the ray.
    """
    east, north, up = place
    hidden, detour = np.zeros(len(sky)), np.full(len(sky), np.nan)
    near = city.obstacles_within(east, north, radius_m)
    if not near:
        return Seen(hidden, detour)
    begin = shapely.Point(east, north)
    shapes = np.array([building.shape for building in near])
    tops = np.array([building.height_m for building in near])
    bases = np.array([building.base_m for building in near])
    azimuths = [satellite.azimuth_rad for satellite in sky]
    ways = _ways(begin, [*azimuths, *(azimuth + pi for azimuth in azimuths)], radius_m, shapes)
    for number, satellite in enumerate(sky):
        slope = tan(satellite.elevation_rad)
        towards, behind = ways[number], ways[len(sky) + number]
        hides = (up + slope * towards < tops) & (up + slope * towards >= bases)  # NaN compares false
        hidden[number] = float(hides.any())
        walls = behind[(up + slope * behind < tops) & (up + slope * behind >= bases)]
        if not len(walls):
            continue
        away_m = float(walls.min())
        above = up + slope * (2.0 * away_m + towards)  # the ray on its way to the wall
        if not ((above < tops) & (above >= bases)).any():
            detour[number] = 2.0 * away_m * cos(satellite.elevation_rad)
    return Seen(hidden, detour)


def _ways(begin: shapely.Point, azimuths_rad: Sequence[float], radius_m: float, shapes: Shapes) -> Floats:
    """(azimuths, n) distance from a point to each footprint, metres; NaN where there is none within the radius."""
    ends = [(begin.x + radius_m * cos(azimuth), begin.y + radius_m * sin(azimuth)) for azimuth in azimuths_rad]
    rays = shapely.linestrings([[(begin.x, begin.y), end] for end in ends])
    return np.asarray(shapely.distance(begin, shapely.intersection(rays[:, None], shapes)), dtype=np.float64)


def solve(sky: tuple[Satellite, ...], errors_m: Floats, strength: Floats) -> tuple[Floats, Floats] | None:
    """What errors of pseudoranges (n,) do to a fix; NaN is a satellite that is not received.

    The fix is that of weighted least squares. A weight is the square of `strength`, the amplitude as a share of that in
    the open (as in the SIGMA-ε model of Hartinger and Brunner, GPS Solutions 2:4, 1999), times that of the sine of the
    elevation (as in RTKLIB). Returns the error of the position (3,) and the dilution of precision east, north and up
    (3,); `None` with fewer than four satellites or with directions that give no fix.
    """
    used = np.isfinite(errors_m)
    if int(used.sum()) < 4:
        return None
    directions = np.array([satellite.unit for satellite, is_used in zip(sky, used, strict=True) if is_used])
    weights = elementary_python.square(strength[used] * directions[:, 2])
    geometry = np.column_stack([-directions, np.ones(len(directions))])
    normal = matrices.multiply(geometry.T, weights[:, None] * geometry)
    if np.linalg.cond(normal) > MOST_CONDITION:
        return None
    inverse = matrices.invert(normal)
    solution = matrices.multiply(inverse, matrices.multiply(geometry.T, weights * errors_m[used]))
    return solution[:3], np.sqrt(np.diag(inverse)[:3])


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
        visibility, count = see(self.city, place, hemisphere, self.radius_m), len(hemisphere)
        errors_m = pseudorange_errors(visibility, self.reflection, self.spacing_chips)
        strength = np.where(visibility.hidden > 0.0, self.reflection, 1.0)
        solved, open_sky = solve(hemisphere, errors_m, strength), solve(hemisphere, np.zeros(count), np.ones(count))
        received = int(np.isfinite(errors_m).sum())
        if solved is None or open_sky is None:
            return received, None
        offset_m, dilution = solved
        flat = float(elementwise.hypot(*dilution[:2]) / elementwise.hypot(*open_sky[1][:2]))
        return received, (offset_m, (flat, float(dilution[2] / open_sky[1][2])))


def pseudorange_errors(visibility: Seen, reflection: float, spacing_chips: float) -> Floats:
    """Errors (n,) in metres of the pseudoranges; NaN for a satellite that is hidden and not reflected.

    A hidden satellite has the whole detour of its reflection. One in sight has the error of a reflection that a delay
    lock loop does not resolve: ±(α·detour) for a short one, and at most α·spacing·chip/2, 7 m for half the amplitude
    and a tenth of a chip (Van Dierendonck, Fenton and Ford, Theory and performance of narrow correlator spacing in a
    GPS receiver, Navigation 39:3, 1992). Its sign and size follow the phase of the detour. Reflections that are longer
    than a chip and a half do no harm.
    """
    detour = visibility.detour_m
    most_m = reflection * spacing_chips * CHIP_M / 2.0
    mixed = np.minimum(reflection * detour, most_m) * elementwise.cos(2.0 * pi * detour / WAVE_M)
    mixed = np.where(np.isnan(detour) | (detour > 1.5 * CHIP_M), 0.0, mixed)
    return np.asarray(np.where(visibility.hidden > 0.0, detour, mixed), dtype=np.float64)


STREAM: Final = "fault.gnss_multipath"
NOTICEABLE_M: Final = 0.5
"""A fix with a smaller error, and with all satellites, is left as it is."""
DEGRADED, LOST = range(2)
"""Phases of a receiver."""


@sky.fault(
    "gnss.multipath",
    surface=("gnss",),
    effect="fixes near walls are metres to tens of metres off, and jump from fix to fix",
    cause="walls that hide satellites and reflect their signals",
    not_modelled="reflections by several walls or by the ground, motion of the satellites, errors of the velocity, and "
    "the receiver's filter and its tests for outliers",
    realism={
        "satellites in sight": "simulated: buildings of the city against an even sky above 10 degrees, assumed",
        "detour of reflections": "cited: 2·d·cos(elevation) by a vertical wall (Hsu, GPS Solutions 22:7, 2018)",
        "errors of satellites in sight": "cited: the envelope of a narrow correlator (Van Dierendonck, Fenton and "
        "Ford, Navigation 39:3, 1992)",
        "position": "simulated: least squares weighted by signal strength and elevation",
        "claimed accuracy": "simulated: grows with the dilution of precision; errors of reflections are not claimed",
    },
)
class Multipath(sky.OnReceivers):
    """Gives GNSS fixes among buildings the errors of hidden and reflected satellites."""

    vehicles: sky.Victims = sky.param("Aircraft whose GNSS fixes are affected, such as ['blue/b1'].")
    reflection: sky.Number = sky.param(
        "Amplitude of a reflected signal, as a share of the direct one's.", default=0.5, gt=0, le=1
    )
    spacing_chips: sky.Number = sky.param(
        "Spacing of the receiver's correlators in C/A chips: 1 is wide, 0.1 narrow.", default=0.1, gt=0, le=1
    )
    radius_m: sky.Number = sky.param("Distance in metres up to which buildings count.", default=150.0, ge=10, le=1_000)
    model: ReflectionModel
    chance: sky.Chance

    def prepare(self, context: sky.FaultContext) -> None:
        """Look for the city. Raises `InputError` without one."""
        if context.city is None:
            hint = "Add [city], such as city = { grid = {} }."
            raise sky.InputError.one(context.id, "vehicles", "no buildings", "a scenario with a city", hint)
        self.model = ReflectionModel(context.city, self.reflection, self.spacing_chips, self.radius_m)
        self.chance = context.chance

    def receive(self, rows: sky.Ints, sensors: sky.Sensors) -> None:
        """Give each new fix the error of reflected signals at the place where it was measured."""
        for row in rows.tolist():
            self.restore(row)
            self.phases[row] = self._degrade(row, sensors)

    def _degrade(self, row: int, sensors: sky.Sensors) -> int:
        """What a receiver makes of its satellites; returns its phase."""
        count = int(sensors.gnss_satellites[row])
        if sensors.gnss_fix[row] < FIX_2D or count < LEAST_SATELLITES:
            return UNALTERED
        hemisphere = even_sky(count, 2.0 * pi * self.chance.uniform4(STREAM, sky.hash64(self.name), 0)[0])
        east, north, up = sensors.gnss_enu_m[row].tolist()
        received, fix = self.model.degrade((east, north, up), hemisphere)
        if fix is None:
            self.fix[row], self.satellites[row] = FIX_NONE, received
            return LOST
        offset_m, dilution = fix
        if received == count and float(elementwise.length(offset_m)) < NOTICEABLE_M:
            return UNALTERED
        self.satellites[row], self.offset[row], self.scale[row, :2] = received, offset_m, dilution
        return DEGRADED
