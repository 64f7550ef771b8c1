"""Claims of airspace that an adversary makes up: a corridor for some time, and the request for it."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from skyrange.attack.contract import AttackContext
from skyrange.contracts.params import Number, Params, refuse
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.geodesy import Origin
from skyrange.core.ids import operator_of
from skyrange.core.time import NS_PER_S, Time, from_seconds
from skyrange.core.volumes import Volume4D
from skyrange.utm.contract import OperationalIntent, intent_id

FAR_NS: Time = 20 * 86_400 * NS_PER_S
"""By how much later the sham claims: nobody flies then, and the request has the same length."""
Point = tuple[Annotated[float, Field(ge=-50_000, le=50_000)], Annotated[float, Field(ge=-50_000, le=50_000)]]


class Stretch(Params):
    """A straight corridor."""

    from_m: Point = Field(description="One end, [east, north] in metres from the origin.")
    to_m: Point = Field(description="The other end, [east, north] in metres.")
    width_m: Number = Field(default=20.0, gt=0, le=10_000, description="Its width in metres.")
    heights_m: tuple[Number, Number] = Field(
        default=(0.0, 120.0), description="Its lowest and highest height above the ground in metres."
    )

    def model_post_init(self, context: object, /) -> None:
        """Refuse a corridor without length or height."""
        if self.from_m == self.to_m:
            raise refuse(Problem("to_m", repr(list(self.to_m)), "another place than from_m"))
        if not -500.0 <= self.heights_m[0] < self.heights_m[1] <= 10_000.0:
            raise refuse(Problem("heights_m", repr(list(self.heights_m)), "[lowest, highest], from -500 to 10000"))


class Corridor(Stretch):
    """A straight corridor for some time."""

    operator: str = Field(description="Operator in whose name it is claimed, such as 'red': the adversary.")
    until_s: Number = Field(
        default=600.0, gt=0, le=86_400, description="Until how long after its begin the attack claims it, in seconds."
    )


def check_operator(params: Corridor, context: AttackContext) -> None:
    """Raise `InputError` for an operator that is not in the scenario."""
    operators = sorted({operator_of(vehicle) for vehicle in context.vehicles})
    if params.operator not in operators:
        hint = nearest(params.operator, operators)
        raise InputError.one(context.id, "operator", repr(params.operator), "an operator of the scenario", hint)


def make_intent(params: Corridor, context: AttackContext, flight: str, now: Time) -> OperationalIntent:
    """The claim of a corridor from `now` on, for a flight that does not exist; of the sham for much later."""
    later_ns = FAR_NS if context.sham else 0
    start, end = now + later_ns, now + later_ns + from_seconds(params.until_s)
    vehicle = f"{params.operator}/{flight}"
    return OperationalIntent(
        intent_id(f"{context.id} {vehicle}"),
        params.operator,
        vehicle,
        (make_prism(params, context.origin, start, end),),
    )


def make_prism(params: Stretch, origin: Origin, start: Time, end: Time) -> Volume4D:
    """The volume of a corridor."""
    one, other = np.array(params.from_m), np.array(params.to_m)
    along = (other - one) / np.linalg.norm(other - one)
    aside = np.array([along[1], -along[0]]) * params.width_m / 2.0
    corners = np.array([one + aside, one - aside, other - aside, other + aside])
    lat, lon = origin.to_geodetic(corners[:, 0], corners[:, 1])
    ground_m = origin.ellipsoid_of(origin.alt_msl_m)
    low, high = params.heights_m
    outline = tuple(zip(lat.tolist(), lon.tolist(), strict=True))
    return Volume4D(outline, ground_m + low, ground_m + high, start, end)
