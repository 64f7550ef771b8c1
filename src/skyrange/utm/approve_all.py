"""Approval of every plan: the approval of the published design, which deconflicts nothing."""

from __future__ import annotations

from skyrange.contracts.plugins.registry import NoParams
from skyrange.core.time import Time
from skyrange.utm.approval_service import policy_plugin
from skyrange.utm.contract import ApprovalDecision, OperationalIntent, version_number


class ApproveAll:
    """Accepts every intent (kind `approve-all`)."""

    kind = "approve-all"

    def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        """Accepted, with an OVN."""
        return ApprovalDecision(accepted=True, ovn=version_number(request))

    def end(self, now: Time, intent: str) -> None:
        """Nothing was kept."""


APPROVE_ALL = policy_plugin(NoParams, lambda params: ApproveAll(), "Accepts every flight plan.")
