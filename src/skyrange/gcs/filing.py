"""How does a plan come before the flight approval? One intent, asked for until it is answered.

The request's bytes stay the same however often it is sent, so a repetition is one request to the approval.
"""

from __future__ import annotations

from dataclasses import dataclass

from skyrange.agent.messages import Scalar
from skyrange.core.ids import operator_of
from skyrange.core.time import NS_PER_MS, Epoch, Time, to_seconds
from skyrange.gcs.flights import Flight
from skyrange.gcs.volumes import volumes
from skyrange.utm.contract import Intent, intent_id
from skyrange.utm.messages import Request, encode

ANSWER_TIMEOUT_NS = 1_500 * NS_PER_MS
MAX_RETRIES = 5
"""Both as the mission protocol's defaults, so that one number describes the station's patience."""


@dataclass(slots=True)
class Filing:
    """One intent on its way to the approval; `due` is when it is sent again."""

    intent: Intent
    payload: bytes
    due: Time
    tries: int = 0

    @classmethod
    def of(cls, flight: Flight, depart_ns: Time, epoch: Epoch) -> Filing:
        """The filing of a flight that departs at `depart_ns`; due at once."""
        vehicle = flight.vehicle
        intent = Intent(intent_id(vehicle), operator_of(vehicle), vehicle, volumes(flight.plan, depart_ns))
        return cls(intent, encode(Request.of(intent, epoch)), depart_ns)

    def try_again(self, now: Time) -> bool:
        """Whether to send it (again) now; false once all retries are used up."""
        if self.tries > MAX_RETRIES:
            return False
        self.tries += 1
        self.due = now + ANSWER_TIMEOUT_NS
        return True

    def summary(self) -> dict[str, Scalar]:
        """What the record says of it."""
        claimed = self.intent.volumes
        return {
            "intent": self.intent.id,
            "volumes": len(claimed),
            "from_s": to_seconds(claimed[0].start_ns),
            "until_s": to_seconds(claimed[-1].end_ns),
        }
