"""What if every plan is approved? The approval of the published design: no deconfliction at all."""

from __future__ import annotations

from hashlib import blake2b

from skyrange.core.time import Time
from skyrange.utm.contract import Decision, Intent


class ApproveAll:
    """Accepts every intent (registered kind `approve-all`)."""

    kind = "approve-all"

    def decide(self, now: Time, request: Intent) -> Decision:
        """Accepted, with an OVN that is a digest of the request's content."""
        return Decision(accepted=True, ovn=blake2b(repr(request).encode(), digest_size=16).hexdigest())
