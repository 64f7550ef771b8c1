"""False details: a USS tells others that its intents claim airspace where nobody flies, and uses what it has claimed.

The DSS knows that the intents are there, but not their volumes. Others ask the USS, believe it, and plan into them.
"""

from __future__ import annotations

import json
from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.approval import check_uss

_BELOW_M: Final = 500.0
"""By how much lower the false volumes are: below the ground."""


@sky.attack(
    "approval.false_details",
    technique="T0856",
    effect="others plan into the airspace that the USS has claimed for its own aircraft, and meet them",
    knowledge="the interface of USSs (ASTM F3548-21)",
    position="a USS of the federation, or who has taken it over",
    equipment="its server",
    load="the sham: the same frames, of the same length, with the true volumes",
    content="none, because the true details are those of the sham",
    placement="a USS whose aircraft fly where nobody else does",
)
class FalseDetails(sky.OnApproval):
    """A USS tells others that its intents claim airspace below the ground."""

    uss: str = sky.param("The USS that lies, by name: the operator's id, unless the federation names others.")

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Taps at the USS. Raises `InputError` for a USS that the scenario does not have."""
        check_uss(self.uss, context)
        return self.at_service(self.uss, context, alters=f"details of {self.uss}")

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Alter the volumes in details and notifications that leave the USS."""
        if not frame.src.endswith(f".{self.uss}") or b'"operational_intent":' not in frame.payload:
            return ()
        try:
            message = json.loads(frame.payload)
            details = message["body"]["operational_intent"]["details"]
            for volume in [*details["volumes"], *details["off_nominal_volumes"]]:
                for bound in ("altitude_lower", "altitude_upper"):
                    volume["volume"][bound]["value"] -= _BELOW_M
        except (ValueError, LookupError, TypeError):
            return ()  # another attack has altered it
        return self.replace_message(frame.payload, message)
