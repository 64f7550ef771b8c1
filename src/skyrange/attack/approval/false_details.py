"""False details: a USS tells others that its intents claim airspace where nobody flies, and uses what it claimed."""

from __future__ import annotations

from typing import Any, Final

import skyrange.plugin as sky
from skyrange.attack.bases.approval.federation import AtUss
from skyrange.attack.bases.approval.links import AltersMessages

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
class FalseDetails(AltersMessages, AtUss):
    """A USS tells others that its intents claim airspace below the ground.

    The DSS knows that the intents are there, but not their volumes. Others ask the USS, believe it, and plan into them.
    """

    alters = "details of"

    def alter(self, message: Any) -> None:
        """Lower the volumes in details and notifications."""
        details = message["body"]["operational_intent"]["details"]
        for volume in [*details["volumes"], *details["off_nominal_volumes"]]:
            for bound in ("altitude_lower", "altitude_upper"):
                volume["volume"][bound]["value"] -= _BELOW_M
