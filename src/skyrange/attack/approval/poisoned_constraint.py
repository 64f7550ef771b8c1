"""Poisoned constraint: who speaks for the constraint manager closes another area than the one that is dangerous.

The extents in the DSS and the details for USSs are those of a corridor. Flights there are refused or return; where
flight is dangerous it is allowed.
"""

from __future__ import annotations

import json
from typing import Any

from skyrange.attack.bases.approval import check_constraint_manager
from skyrange.attack.bases.corridor import InCorridor
from skyrange.attack.contract import Attack, AttackContext, ThreatModel
from skyrange.attack.declaration import attack
from skyrange.attack.presets import true_volumes
from skyrange.codec.f3548.values import volume_body
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.verdicts import Verdicts
from skyrange.core.time import Time
from skyrange.utm.federated.names import AIRSPACE


@attack(
    "approval.poisoned_constraint",
    technique="T0856",
    surface=("uss",),
    persists="flight",
    effect="flights in the corridor are refused, delayed or return; others fly where it is dangerous",
    threat=ThreatModel(
        knowledge="the interface of constraint managers (ASTM F3548-21)",
        position="the constraint manager, who has taken it over, or its network where TLS ends",
        equipment="its server",
        budget="no frames of its own",
    ),
    controls=true_volumes(
        content="none, because a constraint that is true is that of the sham",
        placement="a corridor where nobody flies",
    ),
)
class PoisonedConstraint(InCorridor):
    """Closes a corridor instead of the area that a constraint is about."""

    solid: dict[str, Any]
    """The false Volume3D."""

    def build(self, context: AttackContext) -> Attack:
        """Taps at the constraint manager. Raises `InputError` for a scenario without one."""
        check_constraint_manager(context)
        self.solid = volume_body(self.make_volume(context.origin, 0, 1), context.epoch)["volume"]
        return self.at_service(AIRSPACE, context, alters="constraints")

    def act(self, now: Time, frame: Frame) -> Verdicts:
        """Replace the volumes of constraints that leave the manager, but not their times."""
        if not frame.src.endswith(f".{AIRSPACE}"):
            return ()
        try:
            message = json.loads(frame.payload)
            body = message.get("body") or {}
            volumes = body["extents"] if "extents" in body else body["constraint"]["details"]["volumes"]
            for volume in volumes:
                volume["volume"] = self.solid
        except (ValueError, LookupError, TypeError, AttributeError):
            return ()  # it has no volumes, or another attack has altered it
        return self.replace_message(frame.payload, message)
