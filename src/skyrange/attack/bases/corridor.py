"""Bases of kinds with a corridor: its volume, and claims of it by an operator for flights that do not exist."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from skyrange.attack.bases.approval import OnApproval
from skyrange.attack.bases.on_path import CopyForLink
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Facts
from skyrange.attack.tapped_links import SIDES
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.form import param
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.geodesy import Origin
from skyrange.core.ids import APPROVAL, link_name, operator_of
from skyrange.core.time import NS_PER_S, Time, from_seconds
from skyrange.core.volumes import Volume4D
from skyrange.utm.contract import OperationalIntent, intent_id
from skyrange.utm.messages import Request, encode

FAR_NS: Time = 20 * 86_400 * NS_PER_S
"""By how much later the sham claims: nobody flies then, and the request has the same length."""
Point = tuple[Annotated[float, Field(ge=-50_000, le=50_000)], Annotated[float, Field(ge=-50_000, le=50_000)]]


class InCorridor(OnApproval):
    """Acts on flight approval with a straight corridor."""

    from_m: Point = param("One end, [east, north] in metres from the origin.")
    to_m: Point = param("The other end, [east, north] in metres.")
    width_m: Number = param("Its width in metres.", default=20.0, gt=0, le=10_000)
    heights_m: tuple[Number, Number] = param(
        "Its lowest and highest height above the ground in metres.", default=(0.0, 120.0)
    )

    def find_problems(self) -> Iterator[Problem]:
        """A corridor without length or height."""
        if self.from_m == self.to_m:
            yield Problem("to_m", repr(list(self.to_m)), "another place than from_m")
        elif not -500.0 <= self.heights_m[0] < self.heights_m[1] <= 10_000.0:
            yield Problem("heights_m", repr(list(self.heights_m)), "[lowest, highest], from -500 to 10000")

    def make_volume(self, origin: Origin, start: Time, end: Time) -> Volume4D:
        """The volume of the corridor."""
        one, other = np.array(self.from_m), np.array(self.to_m)
        along = (other - one) / np.linalg.norm(other - one)
        aside = np.array([along[1], -along[0]]) * self.width_m / 2.0
        corners = np.array([one + aside, one - aside, other - aside, other + aside])
        lat, lon = origin.to_geodetic(corners[:, 0], corners[:, 1])
        ground_m = origin.ellipsoid_of(origin.alt_msl_m)
        low, high = self.heights_m
        outline = tuple(zip(lat.tolist(), lon.tolist(), strict=True))
        return Volume4D(outline, ground_m + low, ground_m + high, start, end)


class CorridorClaim(InCorridor):
    """Claims a corridor for some time, in messages on the approval link of an operator."""

    attack_facts: ClassVar[Facts] = {
        "surface": ("approval",),
        "knowledge": "where and when others want to fly",
        "position": "an operator with an account of the approval",
        "equipment": "a ground station",
        "placement": "a corridor where nobody else wants to fly",
    }

    operator: str = param("Operator in whose name it is claimed, such as 'red': the adversary.")
    until_s: Number = param(
        "Until how long after its begin the attack claims it, in seconds.", default=600.0, gt=0, le=86_400
    )
    origin: Origin

    def prepare(self, context: AttackContext) -> None:
        """Learn the origin. Raises `InputError` for an operator that is not in the scenario."""
        operators = sorted({operator_of(vehicle) for vehicle in context.vehicles})
        if self.operator not in operators:
            hint = nearest(self.operator, operators)
            raise InputError.one(context.id, "operator", repr(self.operator), "an operator of the scenario", hint)
        self.origin = context.origin

    def build(self, context: AttackContext) -> Attack:
        """A tap on the approval link of the operator."""
        return Attack(taps=[TapPlacement(link_name(APPROVAL, self.operator), SIDES[APPROVAL], CopyForLink(self))])

    def make_intent(self, flight: str, now: Time, far: bool = False) -> OperationalIntent:
        """The claim of the corridor from `now` on, for a flight that does not exist.

        It is for much later if it is to be `far`, and in a sham.
        """
        later_ns = FAR_NS if far or self.sham else 0
        start, end = now + later_ns, now + later_ns + from_seconds(self.until_s)
        vehicle = f"{self.operator}/{flight}"
        volumes = (self.make_volume(self.origin, start, end),)
        return OperationalIntent(intent_id(f"{self.id} {vehicle}"), self.operator, vehicle, volumes)

    def make_request(self, intent: OperationalIntent, version: int = 0) -> bytes:
        """The message that asks for an intent."""
        return encode(Request.of(intent, self.epoch, version=version))
