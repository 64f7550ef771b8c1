"""Projected depth: two lights make a stereo camera match what does not belong together, at a false depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import skyrange.plugin as sky
from skyrange.attack.bases.light import LightsSensor


@sky.attack(
    "depth.project",
    surface=("depth",),
    effect="the depth camera shows a near obstacle around the direction to two lights",
    technique="EX-0014.03",
    knowledge="the distance between the two cameras and their focal length, and where the aircraft is",
    equipment="two projectors or strong torches on a mount that is aimed at the aircraft",
    budget="light for as long as it acts",
    realism={
        "principle": "cited: two lights, one for each camera, cause false depths by stereo matching and lens flare; "
        "shown on a flying commercial drone, which stopped or drifted away (Zhou et al., DoubleStar, USENIX Security "
        "2022; also on a ZED and a RealSense camera)",
        "range": "cited: up to 15 m at night and 8 m by day (the same); read here as the distance of the lights",
        "size and depth of the patch": "assumed: a patch that faces the camera, at one depth",
        "aim": "assumed: beam, aiming error and delay of the tracking",
        "matching": "assumed: every pixel of the patch is matched; the camera's noise at that depth is simulated",
    },
)  # fmt: skip
class Project(LightsSensor):
    """Makes a stereo depth camera show a near obstacle around the direction to two lights."""

    kinds = ("depth",)
    source = "projectors"

    vehicles: sky.Victims = sky.param("Aircraft whose depth cameras are lied to, such as ['blue/b1'].")
    range_m: sky.Number = sky.param(
        "Distance in metres up to which its light is strong enough.", default=8.0, gt=0, le=1_000
    )
    reach_deg: sky.Number = sky.param(
        "Angular reach: width in degrees of the cone around the direction to the lights, which has the false depth.",
        default=10.0, gt=0, le=180,
    )  # fmt: skip
    beam_mrad: sky.Number = sky.param(
        "Divergence of the beam in milliradians, full angle.", default=100.0, ge=0, le=3_000
    )
    aim_mrad: sky.Number = sky.param(
        "Aiming error in milliradians, one standard deviation on each of two axes, new for each image.",
        default=20.0, ge=0, le=1_000,
    )  # fmt: skip
    depth_m: sky.Number = sky.param(
        "The false depth along the axis of the camera in metres.", default=2.0, gt=0, le=100
    )

    def shine(self, now: sky.Time, light: sky.ScanLight, pulses: NDArray[np.int64]) -> None:
        """Give the pixels a false depth."""
        light.false_echo_m[pulses] = self.depth_m / light.ahead[pulses]
