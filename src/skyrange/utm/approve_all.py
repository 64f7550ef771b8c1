"""Approval of every plan: the approval of the published design, which deconflicts nothing."""

from __future__ import annotations

from hashlib import blake2b

from skyrange.agent.plugins import NoParams
from skyrange.core.time import Time
from skyrange.utm.contract import Decision, Intent
from skyrange.utm.service import policy_plugin


class ApproveAll:
    """Accepts every intent (kind `approve-all`)."""

    kind = "approve-all"

    def decide(self, now: Time, request: Intent) -> Decision:
        """Accepted, with an OVN that is a digest of the request's content."""
        return Decision(accepted=True, ovn=blake2b(repr(request).encode(), digest_size=16).hexdigest())


APPROVE_ALL = policy_plugin(NoParams, lambda params: ApproveAll(), "Accepts every flight plan.")
