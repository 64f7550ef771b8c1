"""Discrete gust: a front of moving air that passes over the fleet, with the shape of half a cosine.

MIL-F-8785C, 3.7.1.3: at a distance x into the gust the air moves at 0 before it (x < 0), at V/2·(1 - cos(π·x/d)) in its
rise of the length d, and at V behind. Here it falls again in the same length, after a part in which it is constant;
without that part it is the pulse of the gust load conditions of large aeroplanes, 14 CFR 25.341(a)(2).

The gust is a field that is carried along unchanged (Taylor's frozen turbulence, "The Spectrum of Turbulence",
Proc. R. Soc. A 164, 1938), so x is the way of its front since the start less the place of the aircraft along its
course. An aircraft that flies against it meets it sooner and faster.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import cos, inf, radians, sin

import numpy as np
from pydantic import Field, model_validator

from skyrange.attack.sensor.injection import need_one
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.contracts.components import BodyAct, Disturbances, Floats
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Enu, Number, Params
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S, Time
from skyrange.fault.contract import FaultContext, FaultParts, FaultPlugin


class Gust(Params):
    """How strong and long the gust is, where it comes from, and whom it meets."""

    speed_mps: Number = Field(
        default=0.0, ge=0, le=60, description="Largest horizontal speed in m/s that comes on top of the wind."
    )
    up_mps: Number = Field(
        default=0.0,
        ge=-60,
        le=60,
        description="Largest vertical speed in m/s that comes on top; negative is down.",
    )
    from_deg: Number = Field(
        default=0.0,
        ge=0,
        le=360,
        description="Direction that the gust comes from and travels from, in degrees clockwise from true north.",
    )
    length_m: Number = Field(
        default=30.0, gt=0, le=10_000, description="Length in metres of the rise, and of the fall."
    )
    hold_m: Number = Field(
        default=0.0, ge=0, le=100_000, description="Length in metres of the part between them, at full speed."
    )
    travel_mps: Number = Field(default=10.0, gt=0, le=100, description="Speed in m/s at which the gust travels.")
    at: Enu = Field(
        default=(0.0, 0.0, 0.0),
        description="Place that the front passes when the fault starts, [east_m, north_m, up_m] in metres; its height "
        "does not count.",
    )
    radius_m: Number | None = Field(
        default=None,
        gt=0,
        le=100_000,
        description="Distance in metres from `at` up to which the gust is felt in full; beyond it, it fades out within "
        "`length_m`. Default: everywhere.",
    )
    vehicles: Victims | None = Field(
        default=None, description="Aircraft that it can meet, such as ['blue/b1']. Default: all of the scenario."
    )

    @model_validator(mode="after")
    def _is_there(self) -> Gust:
        need_one(self, "speed_mps", "up_mps")
        return self


@dataclass(slots=True)
class GustFront:
    """A body fault that moves the air around its vehicles while the gust passes them."""

    name: str
    vehicles: Sequence[str]
    gust: Gust
    schedule: Schedule
    _met: set[str] = field(default_factory=set)
    _share: Floats = field(init=False)

    def __post_init__(self) -> None:
        self._share = np.zeros(len(self.vehicles))

    def on_bodies(self, now: Time, bodies: Disturbances) -> list[BodyAct]:
        """Move the air. Returns an act for each vehicle when the gust reaches it for the first time."""
        if now < self.schedule.start_ns:
            return []
        gust = self.gust
        east, north = -sin(radians(gust.from_deg)), -cos(radians(gust.from_deg))
        way_m = gust.travel_mps * ((now - self.schedule.start_ns) / NS_PER_S)
        radius_m = inf if gust.radius_m is None else gust.radius_m
        shape = (gust.length_m, gust.hold_m, radius_m)
        share = self._share
        if not find_shares(bodies.position_enu_m, gust.at[0], gust.at[1], east, north, way_m, *shape, share):
            return []
        top = (gust.speed_mps * east, gust.speed_mps * north, gust.up_mps)
        for k in range(3):
            bodies.wind_enu_mps[:, k] = share * top[k]
        reached = [self.vehicles[row] for row in np.flatnonzero(share > 0.0).tolist()]
        acts = [BodyAct(vehicle, "wind") for vehicle in reached if vehicle not in self._met]
        self._met.update(reached)
        return acts


@compiled
def find_shares(
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
            share[row] *= rise_to((radius_m + length_m - np.hypot(x, y)) / length_m)
        felt = felt or share[row] > 0.0
    return felt


@compiled
def rise_to(part: float) -> float:
    """Half a cosine, from 0 at 0 to 1 at 1."""
    return float(0.5 * (1.0 - np.cos(np.pi * min(max(part, 0.0), 1.0))))


def make(params: Gust, context: FaultContext) -> FaultParts:
    """The parts. Raises `InputError` for aircraft that are not in the scenario."""
    vehicles = params.vehicles if params.vehicles is not None else tuple(context.vehicles)
    check_vehicles(context, vehicles)
    return FaultParts(body_faults=[GustFront(f"{context.id}.wind", vehicles, params, context.schedule)])


GUST = FaultPlugin(
    Gust,
    make,
    "Lets a discrete gust pass over the fleet, on top of wind and turbulence.",
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
