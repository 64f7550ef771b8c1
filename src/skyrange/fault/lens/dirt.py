"""Dirt on the window of a LiDAR or a camera: spots that block its light, and a film that takes a part of it."""

from __future__ import annotations

from math import ceil
from typing import Final

import numpy as np
from numpy.typing import NDArray

import skyrange.plugin as sky
from skyrange.attack.bases.light import AltersLight
from skyrange.core import elementwise

STREAM: Final = "fault.lens_dirt"


@sky.fault(
    "lens.dirt",
    surface=("lidar", "depth"),
    effect="the sensor sees nothing through some parts of its window, and less far through the rest",
    cause="dust, mud, insects or drops on the window",
    not_modelled="light that dirt scatters back, which makes false returns close by; distortion by drops; dirt that "
    "the air carries away",
    realism={
        "spots": "assumed: squares of `spot_deg` in azimuth and elevation, blocked whole and at random",
        "film": "assumed: one share of the power for the rest of the field, on the ways out and back together",
        "weakened echoes": "simulated: a weaker echo is returned more seldom, and with more noise",
        "cameras": "assumed: a pixel whose light is less than half has no depth",
    },
)
class Dirt(AltersLight):
    """Soils the window of a LiDAR or a depth camera."""

    kinds = ("lidar", "depth")

    vehicles: sky.Victims = sky.param("Aircraft whose sensors are dirty, such as ['blue/b1'].")
    blocked: sky.Number = sky.param("Share of the field that spots block.", default=0.2, ge=0, le=1)
    passes: sky.Number = sky.param(
        "Share of the light that the film between the spots lets pass, out and back together.", default=1.0, ge=0, le=1
    )
    spot_deg: sky.Number = sky.param("Width of a spot in degrees, seen from the sensor.", default=5.0, ge=1, le=90)
    azimuth_deg: tuple[sky.Number, sky.Number] = sky.param(
        "Part of the field that is dirty: [from, to] in degrees clockwise from the nose, from -180 to 180.",
        default=(-180.0, 180.0),
    )

    def find_problems(self) -> sky.Problems:
        """A part of the field that is none, or no dirt."""
        first, last = self.azimuth_deg
        if not -180.0 <= first < last <= 180.0:
            yield sky.Problem("azimuth_deg", f"[{first:g}, {last:g}]", "[from, to] from -180 to 180, the lesser first")
        if self.blocked == 0.0 and self.passes == 1.0:
            yield sky.Problem("blocked", "0", "more than 0, or a share that passes below 1")

    def on_scan(self, now: sky.Time, light: sky.ScanLight) -> bool:
        """Take light away."""
        forward, left, up = light.in_base.T
        azimuth = np.degrees(elementwise.atan2(-left, forward))
        elevation = np.degrees(elementwise.asin(np.clip(up, -1.0, 1.0)))
        dirty = (azimuth >= self.azimuth_deg[0]) & (azimuth <= self.azimuth_deg[1])
        across, high = (
            np.floor(angle / self.spot_deg).astype(np.int64) for angle in (azimuth + 180.0, elevation + 90.0)
        )
        cells = across * (ceil(180.0 / self.spot_deg) + 1) + high
        share = np.where(self._is_blocked(light, cells), 0.0, self.passes)
        light.transmission[dirty] *= share[dirty]
        return bool(dirty.any())

    def _is_blocked(self, light: sky.ScanLight, cells: sky.Ints) -> NDArray[np.bool_]:
        """(n,): whether each of these parts of the window is a spot; the same in all scans."""
        found, back = np.unique(cells, return_inverse=True)
        draws = self.draw(STREAM, light, 0, found)[:, 0]
        return np.asarray((draws < self.blocked)[back])
