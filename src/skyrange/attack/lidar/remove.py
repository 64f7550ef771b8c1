"""Removed points: pulses before the true echoes make a LiDAR discard what is there, or scatter it."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

import skyrange.plugin as sky
from skyrange.attack.bases.light import LIGHT_M_PER_NS
from skyrange.attack.bases.pulses import SendsPulses


@sky.attack(
    "lidar.remove",
    surface=("lidar",),
    effect="the LiDAR does not see what is in a part of its field, so nothing there is avoided",
    technique="EX-0014.03",
    knowledge="near: the scan pattern and the times of the pulses of the LiDAR's model; high_frequency: its wavelength",
    equipment="a laser of the LiDAR's wavelength with a driver for short pulses, and a mount that tracks the aircraft",
    budget="near: a pulse for each pulse of the LiDAR; high_frequency: `rate_mhz` pulses in a microsecond",
    realism={
        "principle": "cited: echoes nearer than what the LiDAR returns replace the true ones and are discarded (Cao et "
        "al., You Can't See Me, USENIX Security 2023, on a VLP-16)",
        "share and reach": "assumed: reported, paper not read: 90 % of the points of an obstacle, and 45 degrees "
        "(the same)",
        "distance": "cited: from no more than 15 feet beside a road (Cao et al.); assumed: `range_m` of 100 m",
        "high frequency": "cited: many pulses randomise the point cloud and hide authentic returns (Sato et al., NDSS "
        "2024; Yoshida et al., arXiv 2604.00371, 2026); assumed: the returned one is any of them with the same odds",
        "generations": "assumed: reported, paper not read: against random times of pulses only high_frequency works "
        "(Sato et al.); assumed: span of the times and share of a fingerprint",
        "aim at an aircraft": "assumed: beam, aiming error and delay of the tracking; not shown on aircraft: all cited "
        "experiments are with cars or in rooms",
    },
)  # fmt: skip
class Remove(SendsPulses):
    """Removes the returns of a LiDAR around the direction to a laser, by pulses that come before the true echoes."""

    vehicles: sky.Victims = sky.param("Aircraft whose LiDARs lose points, such as ['blue/b1'].")
    reach_deg: sky.Number = sky.param(
        "Angular reach: width in degrees of the cone around the direction to the laser, in which points are removed.",
        default=45.0, gt=0, le=180,
    )  # fmt: skip
    method: Literal["near", "high_frequency"] = sky.param(
        "near: an echo that is too near to be returned, for each pulse; high_frequency: pulses at a high rate, "
        "whatever the times of the LiDAR's are.",
        default="near",
    )
    share: sky.Number = sky.param("Share of the pulses within reach that are met.", default=0.9, gt=0, le=1)
    rate_mhz: sky.Number = sky.param("Of high_frequency: pulses in a microsecond.", default=1.0, gt=0, le=1_000)

    def shine(self, now: sky.Time, light: sky.ScanLight, pulses: NDArray[np.int64]) -> None:
        """Send a false echo before the true one, or many of them."""
        draws = self.draw("attack.light.remove", light, now, pulses)
        met = draws[:, 0] < self.share
        pulses, draws = pulses[met], draws[met]
        if self.method == "near":
            taken = self.time_pulses(now, light, pulses, np.full(len(pulses), 0.5 * light.near_m))
            # an error of time towards the LiDAR's own pulse does not undo what covers the true echo
            taken = np.where(np.isnan(taken) & (self.generation == "first"), 0.5 * light.near_m, taken)
        else:
            apart_m = 0.5 * LIGHT_M_PER_NS * 1e3 / self.rate_mhz
            first_m = apart_m * draws[:, 1]
            later = np.maximum(np.floor((light.reach_m - first_m) / apart_m), 0.0)  # further ones within its reach
            taken = self.refuse(first_m + apart_m * np.floor(draws[:, 2] * (later + 1.0)), draws[:, 3])
        told = taken <= light.reach_m
        light.false_echo_m[pulses[told]] = taken[told]
