"""Forged decisions: requests for approval are answered in the name of the approver, before the approver does.

A ground station takes the first answer to its request, and later ones change nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final, Literal

from pydantic import Field

from skyrange.attack.approval.approval_links import approval_taps
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import TapMaker
from skyrange.attack.victims import Victims
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Params
from skyrange.contracts.verdicts import Inject, Verdict
from skyrange.core.errors import DecodeError
from skyrange.core.ids import APPROVAL
from skyrange.core.time import Epoch, Time
from skyrange.utm.contract import ApprovalDecision, intent_id
from skyrange.utm.messages import Response, decode_request, encode

_NEVER_SUBMITTED: Final = 1_000_000
"""Version of an intent that no operator submits: the sham answers it."""
_OVN: Final = "0" * 32
"""Version number in a forged acceptance: the operator cannot check it, and a real one looks as random."""


class ForgedDecision(Params):
    """What the flights are told."""

    vehicles: Victims = Field(description="Aircraft whose requests are answered, such as ['blue/b1'].")
    decision: Literal["Rejected", "Accepted"] = Field(
        default="Rejected",
        description="Rejected: the flight does not take place; Accepted: it does, whatever the approver decides.",
    )
    reason: Annotated[str, Field(max_length=256)] = Field(
        default="conflict with an earlier intent", description="Reason in a rejection, at most 256 characters."
    )


@dataclass(slots=True)
class ForgingTap:
    """Answers each request for the aircraft at once; the sham answers an intent that nobody submitted."""

    link: str
    vehicles: frozenset[str]
    decision: ApprovalDecision
    epoch: Epoch
    schedule: Schedule
    sham: bool

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Let it pass, and answer a request."""
        if frame.direction != "fwd" or not self.schedule.start_ns <= now < self.schedule.stop_ns:
            return ()
        try:
            body = decode_request(frame.payload).body
        except DecodeError:
            return ()
        if body.vehicle not in self.vehicles:
            return ()
        about = intent_id(body.vehicle, _NEVER_SUBMITTED) if self.sham else body.id
        return [Inject(encode(Response.of(about, self.decision, self.epoch)), "rev", APPROVAL, frame.src)]

    def next_wakeup(self) -> Time | None:
        """Never."""
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Nothing."""
        return ()


def make(params: ForgedDecision, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    accepted = params.decision == "Accepted"
    decision = ApprovalDecision(accepted, "" if accepted else params.reason, ovn=_OVN if accepted else "")
    arguments = (frozenset(params.vehicles), decision, context.epoch, context.schedule, context.sham)
    taps = approval_taps(params.vehicles, context, TapMaker(ForgingTap, arguments))
    return Attack(taps=taps, exclusive=[Exclusive(f"decision on {vehicle}") for vehicle in params.vehicles])


FORGED_DECISION = AttackPlugin(
    ForgedDecision,
    make,
    "Answers requests for flight approval in the name of the approver.",
    technique="T0856",
    surface=("approval",),
    persists="flight",
    effect="flights that the approver accepts do not take place, or flights that it rejects do",
    threat=ThreatModel(
        knowledge="the form of requests and answers (ASTM F3548-21); the id of an intent from the request that passes",
        position="on the network between ground station and approver, without authentication of the answers",
        equipment="a router or a computer that answers faster than the approver",
        budget="one frame of about 300 bytes for each request",
    ),
    controls=Controls(
        load="the sham: an answer to an intent that was not submitted, which the station counts and ignores",
        content="a forged acceptance, where the approver accepts too",
        placement="the request of another aircraft",
    ),
)
