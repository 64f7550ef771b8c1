"""Discrete gust: a front of moving air that passes over the fleet.

MIL-F-8785C, 3.7.1.3: at a distance x into the gust the air moves at 0 before it (x < 0), at V/2·(1 - cos(π·x/d)) in its
rise of the length d, and at V behind. Here it falls again in the same length, after a part in which it is constant;
without that part it is the pulse of the gust load conditions of large aeroplanes, 14 CFR 25.341(a)(2).

The gust is a field that is carried along unchanged (Taylor's frozen turbulence, "The Spectrum of Turbulence",
Proc. R. Soc. A 164, 1938), so x is the way of its front since the start less the place of the aircraft along its
course. An aircraft that flies against it meets it sooner and faster.
"""

from __future__ import annotations

from math import inf, radians

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.sensors import need_one
from skyrange.contracts.components import Floats
from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.core.elementary import cos, sin


@compiled
def find_shares(  # noqa: PLR0917
    position_enu_m: Floats, at_east_m: float, at_north_m: float, east: float, north: float, way_m: float,
    length_m: float, hold_m: float, radius_m: float, share: Floats,
) -> bool:  # fmt: skip
    """Write the gust's share (n,) of its full speed at each place (n, 3); returns whether any is not 0.

    `east` and `north` are its course, `way_m` is the way of its front since the start. Beyond `radius_m` from where it
    started it fades out within `length_m`.
    """
    felt = False
    for row in range(len(share)):
        x, y = position_enu_m[row, 0] - at_east_m, position_enu_m[row, 1] - at_north_m
        into_m = way_m - (x * east + y * north)
        share[row] = rise_to(min(into_m, 2.0 * length_m + hold_m - into_m) / length_m)
        if radius_m < np.inf:
            share[row] *= rise_to((radius_m + length_m - elementary.hypot(x, y)) / length_m)
        felt = felt or share[row] > 0.0
    return felt


@compiled
def rise_to(part: float) -> float:
    """Half a cosine, from 0 at 0 to 1 at 1."""
    return float(0.5 * (1.0 - elementary.cos(np.pi * min(max(part, 0.0), 1.0))))


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
