"""Forged decisions: requests for approval are answered in the name of the approver, before the approver does.

A ground station takes the first answer to its request, and later ones change nothing.
"""

from __future__ import annotations

from typing import Final, Literal

from skyrange.attack.bases.approval import OnApproval, approval_taps
from skyrange.attack.bases.on_path import CopyForLink
from skyrange.attack.contract import Attack, AttackContext, Controls, ThreatModel
from skyrange.attack.declaration import attack
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.victims import Victims
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.plugins.fields import param
from skyrange.contracts.verdicts import Inject, Verdicts
from skyrange.core.errors import DecodeError
from skyrange.core.ids import APPROVAL
from skyrange.core.time import Epoch, Time
from skyrange.utm.contract import ApprovalDecision, intent_id
from skyrange.utm.messages import Response, decode_request, encode

_NEVER_SUBMITTED: Final = 1_000_000
"""Version of an intent that no operator submits: the sham answers it."""
_OVN: Final = "0" * 32
"""Version number in a forged acceptance: the operator cannot check it, and a real one looks as random."""


@attack(
    "approval.forged_decision",
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
class ForgedDecision(OnApproval):
    """Answers requests for flight approval in the name of the approver."""

    vehicles: Victims = param("Aircraft whose requests are answered, such as ['blue/b1'].")
    decision: Literal["Rejected", "Accepted"] = param(
        "Rejected: the flight does not take place; Accepted: it does, whatever the approver decides.",
        default="Rejected",
    )
    reason: str = param(
        "Reason in a rejection, at most 256 characters.", default="conflict with an earlier intent", max_length=256
    )
    epoch: Epoch

    def build(self, context: AttackContext) -> Attack:
        """Taps on approval links. Raises `InputError` for aircraft that are not in the scenario."""
        self.epoch = context.epoch
        taps = approval_taps(self.vehicles, context, CopyForLink(self))
        return Attack(taps=taps, exclusive=[Exclusive(f"decision on {vehicle}") for vehicle in self.vehicles])

    def act(self, now: Time, frame: Frame) -> Verdicts:
        """Answer a request at once; the sham answers an intent that nobody submitted."""
        if frame.direction != "fwd":
            return ()
        try:
            body = decode_request(frame.payload).body
        except DecodeError:
            return ()
        if body.vehicle not in self.vehicles:
            return ()
        accepted = self.decision == "Accepted"
        decision = ApprovalDecision(accepted, "" if accepted else self.reason, ovn=_OVN if accepted else "")
        about = intent_id(body.vehicle, _NEVER_SUBMITTED) if self.sham else body.id
        return (Inject(encode(Response.of(about, decision, self.epoch)), "rev", APPROVAL, frame.src),)
