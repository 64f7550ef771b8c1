"""Squatting: an operator claims a corridor for flights that do not exist, so that others get no airspace.

Nothing of it is forged: the operator has an account with its approval, and asks for what it may ask for.
"""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.corridor import CorridorClaim


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
        self.when = sky.Repetition(self.schedule, sky.from_seconds(self.every_s), self.requests)

    def send(self, now: sky.Time, turn: int) -> bytes:
        return self.make_request(self.make_intent(f"squat-{turn}", now))
