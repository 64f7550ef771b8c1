"""Squatting: an operator claims a corridor for flights that do not exist, so that others get no airspace.

Nothing of it is forged: the operator has an account with its approval, and asks for what it may ask for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import Field

from skyrange.attack.approval.claims import Corridor, check_operator, make_intent
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.on_path import SIDES, InjectingTap, RepeatedSource, Repetition
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import Number
from skyrange.contracts.verdicts import Direction
from skyrange.core.ids import APPROVAL, link_name
from skyrange.core.time import Time, from_seconds
from skyrange.utm.messages import Request, encode


class Squat(Corridor):
    """The corridor, and how often it is claimed."""

    requests: int = Field(default=1, ge=1, le=100_000, description="Number of requests, each for another flight.")
    every_s: Number = Field(default=1.0, ge=0.001, le=86_400, description="Time between two requests in seconds.")


@dataclass(slots=True)
class Squatting(RepeatedSource):
    """Requests for flights that do not exist."""

    params: Squat
    context: AttackContext

    def make(self, now: Time) -> Sequence[tuple[Direction, bytes]]:
        """The request that is due."""
        if not self.when.take(now):
            return ()
        intent = make_intent(self.params, self.context, f"squat-{self.when.done}", now)
        return [("fwd", encode(Request.of(intent, self.context.epoch)))]


@dataclass(frozen=True, slots=True)
class _Maker:
    params: Squat
    context: AttackContext

    def __call__(self, link: str) -> InjectingTap:
        when = Repetition(self.context.schedule, from_seconds(self.params.every_s), self.params.requests)
        return InjectingTap(link, Squatting(when, self.params, self.context))


def make(params: Squat, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for an operator that is not in the scenario."""
    check_operator(params, context)
    link = link_name(APPROVAL, params.operator)
    return Attack(taps=[TapPlacement(link, SIDES[APPROVAL], _Maker(params, context))])


SQUAT = AttackPlugin(
    Squat,
    make,
    "Claims a corridor for flights that do not exist.",
    technique="T0814",
    surface=("approval",),
    persists="flight",
    effect="others are rejected, delayed or sent around; with many requests the approval is slow for all",
    threat=ThreatModel(
        knowledge="where and when others want to fly",
        position="an operator with an account of the approval",
        equipment="a ground station",
        budget="one request of about 1 kB for each claim",
    ),
    controls=Controls(
        load="the sham: as many requests of the same length, for the same corridor twenty days later",
        content="a claim for a flight that takes place",
        placement="a corridor where nobody else wants to fly",
    ),
)
