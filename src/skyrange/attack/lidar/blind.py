"""Blinding: strong light saturates the receiver of a LiDAR around the direction to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import skyrange.plugin as sky
from skyrange.attack.bases.light import LightsSensor


@sky.attack(
    "lidar.blind",
    surface=("lidar",),
    effect="the LiDAR returns nothing, or noise, in the direction of a strong light",
    technique="T0814",
    knowledge="the wavelength of the LiDAR",
    equipment="a strong laser of the LiDAR's wavelength, and a mount that tracks the aircraft",
    budget="light for as long as it acts",
    realism={
        "principle": "cited: strong light saturates a VLP-16, which then returns nothing in a sector, and weaker light "
        "makes it return points at random distances (Shin et al., Illusion and Dazzle, CHES 2017)",
        "reach": "assumed: it depends on the power and on reflections in the window",
        "generations": "assumed: no difference, because a saturated receiver has no pulses to tell apart",
        "aim at an aircraft": "assumed: beam, aiming error and delay of the tracking; not shown on aircraft: the cited "
        "experiments are in rooms",
    },
)  # fmt: skip
class Blind(LightsSensor):
    """Saturates the receiver of a LiDAR around the direction to a strong light."""

    vehicles: sky.Victims = sky.param("Aircraft whose LiDARs are blinded, such as ['blue/b1'].")
    reach_deg: sky.Number = sky.param(
        "Angular reach: width in degrees of the cone around the direction to the light, which is blinded.",
        default=20.0, gt=0, le=180,
    )  # fmt: skip
    noise: sky.Number = sky.param(
        "Share of the blinded pulses that return a random distance instead of nothing; light that is too weak to blind "
        "has more.",
        default=0.0, ge=0, le=1,
    )  # fmt: skip

    def shine(self, now: sky.Time, light: sky.ScanLight, pulses: NDArray[np.int64]) -> None:
        """Saturate the receiver."""
        draws = self.draw("attack.light.blind", light, now, pulses)
        noisy = draws[:, 0] < self.noise
        light.is_blind[pulses[~noisy]] = True
        light.false_echo_m[pulses[noisy]] = light.near_m + draws[noisy, 1] * (light.reach_m - light.near_m)
