"""Forged decisions: requests for approval are answered in the name of the approver, before the approver does."""

from __future__ import annotations

from typing import Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.approval.links import approval_taps, read_request

_NEVER_SUBMITTED: Final = 1_000_000
"""Version of an intent that no operator submits: the sham answers it."""
_OVN: Final = "0" * 32
"""Version number in a forged acceptance: the operator cannot check it, and a real one looks as random."""


@sky.attack(
    "approval.forged_decision",
    technique="T0856",
    intrudes=True,
    surface=("approval",),
    effect="flights that the approver accepts do not take place, or flights that it rejects do",
    knowledge="the form of requests and answers (ASTM F3548-21); the id of an intent from the request that passes",
    position="on the network between ground station and approver, without authentication of the answers",
    equipment="a router or a computer that answers faster than the approver",
    budget="one frame of about 300 bytes for each request",
    load="the sham: an answer to an intent that was not submitted, which the station counts and ignores",
    content="a forged acceptance, where the approver accepts too",
    placement="the request of another aircraft",
)
class ForgedDecision(sky.OnApproval):
    """Answers requests for flight approval in the name of the approver."""

    vehicles: sky.Victims = sky.param("Aircraft whose requests are answered, such as ['blue/b1'].")
    decision: Literal["Rejected", "Accepted"] = sky.param(
        "Rejected: the flight does not take place; Accepted: it does, whatever the approver says.", default="Rejected"
    )
    reason: str = sky.param("Reason in a rejection.", default="conflict with an earlier intent", max_length=256)

    def build(self, context: sky.AttackContext) -> sky.Attack:
        taps = approval_taps(self.vehicles, context, self)
        return sky.Attack(taps=taps, exclusive=[sky.Exclusive(f"decision on {vehicle}") for vehicle in self.vehicles])

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Answer a request at once; the sham answers an intent that nobody submitted."""
        request = read_request(frame, self.vehicles)
        if request is None:
            return ()
        accepted = self.decision == "Accepted"
        decision = sky.ApprovalDecision(accepted, "" if accepted else self.reason, ovn=_OVN if accepted else "")
        about = sky.intent_id(request.body.vehicle, _NEVER_SUBMITTED) if self.sham else request.body.id
        return [self.answer(frame, sky.encode_approval(sky.ApprovalResponse.of(about, decision, self.epoch)))]
