"""Squatting: an operator asks, as it may, for a corridor for flights that do not exist; others get no airspace."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.approval.links import CorridorClaim


@sky.attack(
    "approval.squat",
    technique="T0814",
    effect="others are rejected, delayed or sent around; with many requests the approval is slow for all",
    budget="one request of about 1 kB for each claim",
    load="the sham: as many requests of the same length, for the same corridor twenty days later",
    content="a claim for a flight that takes place",
)
class Squat(CorridorClaim):
    """Claims a corridor for flights that do not exist."""

    requests: int = sky.param("Number of requests, each for another flight.", default=1, ge=1, le=100_000)
    every_s: sky.Number = sky.param("Time between two requests in seconds.", default=1.0, ge=0.001, le=86_400)

    def prepare(self, context: sky.AttackContext) -> None:
        super().prepare(context)
        self.times = self.requests

    def send(self, now: sky.Time) -> sky.Verdicts:
        return [self.inject(self.make_request(self.make_intent(f"squat-{self.clock.done}", now)))]
