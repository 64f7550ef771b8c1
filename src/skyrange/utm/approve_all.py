"""Approval of every plan: the approval of the published design, which deconflicts nothing."""

from __future__ import annotations

from hashlib import blake2b

from skyrange.contracts.plugins import NoParams
from skyrange.core.time import Time
from skyrange.utm.approval_service import policy_plugin
from skyrange.utm.contract import ApprovalDecision, OperationalIntent


class ApproveAll:
    """Accepts every intent (kind `approve-all`)."""

    kind = "approve-all"

    def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        """Accepted, with an OVN that is a digest of the request's content."""
        # OVNs are recorded: they keep the prefix "Intent" whatever the class is called
        content = "Intent" + repr(request).removeprefix(type(request).__name__)
        return ApprovalDecision(accepted=True, ovn=blake2b(content.encode(), digest_size=16).hexdigest())


APPROVE_ALL = policy_plugin(NoParams, lambda params: ApproveAll(), "Accepts every flight plan.")
