"""Squatting: an operator claims a corridor for flights that do not exist, so that others get no airspace.

Nothing of it is forged: the operator has an account with its approval, and asks for what it may ask for.
"""

from __future__ import annotations

from skyrange.attack.bases.corridor import CorridorClaim
from skyrange.attack.contract import AttackContext, Controls
from skyrange.attack.declaration import attack
from skyrange.attack.presets import acts_as_operator
from skyrange.attack.tapped_links import Repetition
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.core.time import Time, from_seconds


@attack(
    "approval.squat",
    technique="T0814",
    surface=("approval",),
    persists="flight",
    effect="others are rejected, delayed or sent around; with many requests the approval is slow for all",
    threat=acts_as_operator(budget="one request of about 1 kB for each claim"),
    controls=Controls(
        load="the sham: as many requests of the same length, for the same corridor twenty days later",
        content="a claim for a flight that takes place",
        placement="a corridor where nobody else wants to fly",
    ),
)
class Squat(CorridorClaim):
    """Claims a corridor for flights that do not exist."""

    requests: int = param("Number of requests, each for another flight.", default=1, ge=1, le=100_000)
    every_s: Number = param("Time between two requests in seconds.", default=1.0, ge=0.001, le=86_400)

    def prepare(self, context: AttackContext) -> None:
        """Send some requests."""
        super().prepare(context)
        self.when = Repetition(self.schedule, from_seconds(self.every_s), self.requests)

    def send(self, now: Time, turn: int) -> bytes:
        """A request."""
        return self.make_request(self.make_intent(f"squat-{turn}", now))
