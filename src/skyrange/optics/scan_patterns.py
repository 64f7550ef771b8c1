"""Scan patterns: in which directions a sensor looks during one scan, and when.

Directions are in the frame of the sensor, which is that of a body: forward, left, up. Azimuths count clockwise from
forward, seen from above.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from skyrange.core import elementary_python, elementwise
from skyrange.core.arrays import Floats, Words

_RADIANS: Final = math.pi / 180.0
_STEP_X: Final = 13925035116211876495
_STEP_Y: Final = 10511698010929265436
"""Inverse powers of the plastic number times 2**64: multiples of them, modulo 2**64, are spread evenly over a square
(Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018)."""
_WORD: Final = 2.0**-64


class Firing(NamedTuple):
    """The n rays of one scan."""

    direction: Floats
    """(n, 3) unit vectors: forward, left, up."""
    delay_s: Floats
    """(n,): since the start of the scan."""
    number: Words
    """(n,): of the ray in the scan, by which its chance is addressed."""


def choose_rays(firing: Firing, rows: NDArray[Any]) -> Firing:
    """Some rays of a scan (rows, or a mask), with their own times and numbers."""
    return Firing(firing.direction[rows], firing.delay_s[rows], firing.number[rows])


def _number(direction: Floats, delay_s: Floats) -> Firing:
    return Firing(direction, delay_s, np.arange(len(delay_s), dtype=np.uint64))


class ScanPattern(Protocol):
    """How a sensor scans."""

    @property
    def rate_hz(self) -> float:
        """Scans per second."""

    def list_rays(self, scan: int) -> Firing:
        """The rays of scan number `scan`, counted from 0."""


def _point(azimuth: Floats, elevation: Floats) -> Floats:
    level = elementwise.cos(elevation)
    return np.column_stack(
        [level * elementwise.cos(azimuth), -level * elementwise.sin(azimuth), elementwise.sin(elevation)]
    )


@dataclass(frozen=True, slots=True)
class RotatingPattern:
    """Beams at fixed elevations that fire one after the other while the head turns: each scan repeats the last."""

    elevation_deg: tuple[float, ...]
    """In the order in which the beams fire."""
    sequence_s: float
    """Time from the first beam of a sequence to the first one of the next."""
    firing_s: float
    """Time from one beam to the next."""
    rate_hz: float

    @property
    def sequences(self) -> int:
        """Azimuth steps of a scan: sequences that fit into one turn."""
        return math.floor(1.0 / (self.rate_hz * self.sequence_s) + 1e-9)

    def list_rays(self, scan: int) -> Firing:
        """As of `ScanPattern`: sequence by sequence. The head turns between the beams of a sequence too."""
        beams = len(self.elevation_deg)
        number = np.arange(self.sequences * beams)
        delay_s = self.sequence_s * (number // beams) + self.firing_s * (number % beams)
        elevation = _RADIANS * np.tile(np.array(self.elevation_deg), self.sequences)
        return _number(_point(2.0 * math.pi * self.rate_hz * delay_s, elevation), delay_s)


@dataclass(frozen=True, slots=True)
class ScatteredPattern:
    """Rays that cover the field evenly and never twice alike: a stand-in for a non-repetitive scan.

    A real one moves along curves, whose density varies over the field.
    """

    rays: int
    """In one scan."""
    azimuth_deg: tuple[float, float]
    elevation_deg: tuple[float, float]
    rate_hz: float

    def list_rays(self, scan: int) -> Firing:
        """As of `ScanPattern`: the next points of an additive recurrence over azimuth and elevation."""
        number = (np.arange(self.rays, dtype=np.uint64) + np.uint64(scan * self.rays % 2**64)).astype(np.uint64)
        across, up = (_WORD * (number * np.uint64(step)).astype(np.float64) for step in (_STEP_X, _STEP_Y))
        azimuth = _RADIANS * (self.azimuth_deg[0] + across * (self.azimuth_deg[1] - self.azimuth_deg[0]))
        elevation = _RADIANS * (self.elevation_deg[0] + up * (self.elevation_deg[1] - self.elevation_deg[0]))
        return _number(_point(azimuth, elevation), np.arange(self.rays) / (self.rays * self.rate_hz))


@dataclass(frozen=True, slots=True)
class SingleBeam:
    """One beam in a fixed direction."""

    direction: tuple[float, float, float]
    """Unit vector: forward, left, up."""
    rate_hz: float

    def list_rays(self, scan: int) -> Firing:
        """As of `ScanPattern`: one ray."""
        return _number(np.array([self.direction]), np.zeros(1))


@dataclass(frozen=True, slots=True)
class PixelGrid:
    """One ray through the centre of each pixel of a camera without distortion, row by row, all at once."""

    width: int
    height: int
    field_deg: tuple[float, float]
    """Horizontal and vertical field of view."""
    rate_hz: float

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal length in pixels, horizontal and vertical."""
        across, up = (elementary_python.tan(0.5 * _RADIANS * degrees) for degrees in self.field_deg)
        return 0.5 * self.width / across, 0.5 * self.height / up

    def list_rays(self, scan: int) -> Firing:
        """As of `ScanPattern`."""
        focal = self.focal_px
        column, row = np.arange(self.width) + 0.5, np.arange(self.height) + 0.5
        left = np.tile((0.5 * self.width - column) / focal[0], self.height)
        up = np.repeat((0.5 * self.height - row) / focal[1], self.width)
        vectors = np.column_stack([np.ones(self.width * self.height), left, up])
        return _number(vectors / elementwise.length(vectors)[:, None], np.zeros(len(vectors)))


def count_pulses(pattern: ScanPattern) -> int:
    """Pulses of a scan, or pixels of an image."""
    if isinstance(pattern, PixelGrid):
        return pattern.width * pattern.height
    if isinstance(pattern, RotatingPattern):
        return pattern.sequences * len(pattern.elevation_deg)
    if isinstance(pattern, ScatteredPattern):
        return pattern.rays
    return 1 if isinstance(pattern, SingleBeam) else len(pattern.list_rays(0).delay_s)
