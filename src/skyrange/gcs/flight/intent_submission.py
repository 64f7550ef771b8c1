"""Submission of one operational intent to the flight approval, repeated until it is answered.

Every repetition has the same bytes, so the approval recognises it as one request.
"""

from __future__ import annotations

from dataclasses import dataclass

from skyrange.contracts.scalars import Scalar
from skyrange.core.ids import operator_of
from skyrange.core.time import NS_PER_MS, Epoch, Time, to_seconds
from skyrange.gcs.flight.flight import Flight
from skyrange.gcs.plan.volumes import volumes
from skyrange.utm.contract import OperationalIntent, intent_id
from skyrange.utm.messages import Request, encode

ANSWER_TIMEOUT_NS = 1_500 * NS_PER_MS
MAX_RETRIES = 5
"""Both equal the defaults of the MAVLink mission protocol, so that all retries of the station follow one rule."""


@dataclass(slots=True)
class IntentSubmission:
    """One intent that awaits its decision; `due` is when it is sent (again)."""

    intent: OperationalIntent
    payload: bytes
    due: Time
    tries: int = 0

    @classmethod
    def for_flight(cls, flight: Flight, depart_ns: Time, epoch: Epoch) -> IntentSubmission:
        """The submission for a flight that departs at `depart_ns`; due at once."""
        vehicle = flight.vehicle
        intent = OperationalIntent(intent_id(vehicle), operator_of(vehicle), vehicle, volumes(flight.plan, depart_ns))
        return cls(intent, encode(Request.of(intent, epoch)), depart_ns)

    def count_attempt(self, now: Time) -> bool:
        """Count an attempt and return whether to send it now; false once all retries are used up."""
        if self.tries > MAX_RETRIES:
            return False
        self.tries += 1
        self.due = now + ANSWER_TIMEOUT_NS
        return True

    def summary(self) -> dict[str, Scalar]:
        """The details that are recorded: intent id, number of volumes, and the time that they span."""
        claimed = self.intent.volumes
        return {
            "intent": self.intent.id,
            "volumes": len(claimed),
            "from_s": to_seconds(claimed[0].start_ns),
            "until_s": to_seconds(claimed[-1].end_ns),
        }
