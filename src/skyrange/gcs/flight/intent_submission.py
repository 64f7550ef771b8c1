"""Submission of one request to the flight approval, repeated until it is answered.

Every repetition has the same bytes, so the approval recognises it as one request.
"""

from __future__ import annotations

from dataclasses import dataclass

from skyrange.contracts.alerts import Scalar
from skyrange.core.time import NS_PER_MS, Epoch, Time, to_seconds
from skyrange.utm.contract import OperationalIntent
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import DecisionBody, Request, encode, encode_request

ANSWER_TIMEOUT_NS = 1_500 * NS_PER_MS
MAX_RETRIES = 5
"""Both equal the defaults of the MAVLink mission protocol, so that all retries of the station follow one rule."""


@dataclass(slots=True)
class IntentSubmission:
    """One version of an intent that awaits its decision; `due` is when it is sent (again)."""

    intent: OperationalIntent
    payload: bytes
    version: int
    due: Time
    tries: int = 0

    @classmethod
    def of(cls, intent: OperationalIntent, version: int, due: Time, epoch: Epoch) -> IntentSubmission:
        """The submission of an intent, or of its end."""
        ends = intent.state is IntentState.ENDED
        payload = encode(Request.end(intent)) if ends else encode_request(intent, epoch, version)
        return cls(intent, payload, version, due)

    def count_attempt(self, now: Time) -> bool:
        """Count an attempt and return whether to send it now; false once all retries are used up."""
        if self.tries > MAX_RETRIES:
            return False
        self.tries += 1
        self.due = now + ANSWER_TIMEOUT_NS
        return True

    def is_answered_by(self, decision: DecisionBody) -> bool:
        """Whether a decision is about this request."""
        if self.intent.state is IntentState.ENDED or decision.decision == "Ended":
            return self.intent.state is IntentState.ENDED and decision.decision == "Ended"
        return not decision.overruled and (decision.version or 0) == self.version

    def summary(self) -> dict[str, Scalar]:
        """The details that are recorded: intent id, number of volumes, and the time that they span."""
        claimed = self.intent.volumes
        return {
            "intent": self.intent.id,
            "volumes": len(claimed),
            "from_s": to_seconds(claimed[0].start_ns),
            "until_s": to_seconds(claimed[-1].end_ns),
        }
