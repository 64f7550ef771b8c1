"""Discrete gust: a front of moving air that passes over the fleet."""

from __future__ import annotations

from math import cos, inf, radians, sin

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.sensors import need_one
from skyrange.fault.gust_field import find_shares


@sky.fault(
    "gust",
    surface=("wind",),
    effect="the aircraft is carried off its track, leans against the wind, and takes more power",
    cause="a thunderstorm's outflow, a passing front, or the edge of a building's wake",
    not_modelled="the shape of a real front, its change with height, what buildings do to it, and a gust that turns an "
    "aircraft because it meets one rotor before the others; aircraft whose pose their autopilot imposes are refused",
    realism={
        "shape": "cited: 1 - cosine (MIL-F-8785C 3.7.1.3); with the fall, 14 CFR 25.341(a)(2)",
        "motion": "assumed: it travels unchanged, at a speed of its own",
        "forces": "simulated: drag of body and rotors in the moving air",
        "size and length": "assumed: the parameters say them",
    },
)
class Gust(sky.OnBodies):
    """Lets a discrete gust pass over the fleet, on top of wind and turbulence."""

    speed_mps: sky.Number = sky.param(
        "Largest horizontal speed in m/s that comes on top of the wind.", default=0.0, ge=0, le=60
    )
    up_mps: sky.Number = sky.param(
        "Largest vertical speed in m/s that comes on top; negative is down.", default=0.0, ge=-60, le=60
    )
    from_deg: sky.Number = sky.param(
        "Direction that the gust comes from, in degrees clockwise from true north.", default=0.0, ge=0, le=360
    )
    length_m: sky.Number = sky.param("Length in metres of the rise, and of the fall.", default=30.0, gt=0, le=10_000)
    hold_m: sky.Number = sky.param("Length in metres at full speed between them.", default=0.0, ge=0, le=100_000)
    travel_mps: sky.Number = sky.param("Speed in m/s at which the gust travels.", default=10.0, gt=0, le=100)
    at: sky.Enu = sky.param(
        "Place that the front passes at the start, [east_m, north_m, up_m] in metres; its height does not count.",
        default=(0.0, 0.0, 0.0),
    )
    radius_m: sky.Number | None = sky.param(
        "Distance in metres from `at` up to which the gust is felt in full; beyond it, it fades out within `length_m`. "
        "Default: everywhere.",
        default=None, gt=0, le=100_000,
    )  # fmt: skip
    vehicles: sky.Victims | None = sky.param(
        "Aircraft that it can meet, such as ['blue/b1']. Default: all of the scenario.", default=None
    )
    share: sky.Floats
    """(n,) Of its full speed, at each vehicle."""

    def find_problems(self) -> sky.Problems:
        """It has no speed."""
        return need_one(self, "speed_mps", "up_mps")

    def prepare(self, context: sky.FaultContext) -> None:
        """Take all aircraft, if none are named."""
        self.vehicles = tuple(context.vehicles) if self.vehicles is None else self.vehicles
        self.share = np.zeros(len(self.vehicles))

    def on_bodies(self, now: sky.Time, bodies: sky.Disturbances) -> list[sky.BodyAct]:
        """Move the air. Returns an act for each vehicle when the gust reaches it for the first time."""
        if now < self.schedule.start_ns:
            return []
        east, north = -sin(radians(self.from_deg)), -cos(radians(self.from_deg))
        way_m = self.travel_mps * ((now - self.schedule.start_ns) / sky.NS_PER_S)
        shape = (self.length_m, self.hold_m, inf if self.radius_m is None else self.radius_m)
        share = self.share
        if not find_shares(bodies.position_enu_m, self.at[0], self.at[1], east, north, way_m, *shape, share):
            return []
        top = (self.speed_mps * east, self.speed_mps * north, self.up_mps)
        for k in range(3):
            bodies.wind_enu_mps[:, k] = share * top[k]
        return self.meet(np.flatnonzero(share > 0.0).tolist())
