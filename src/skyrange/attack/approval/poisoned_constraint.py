"""Poisoned constraint: who speaks for the constraint manager closes another area than the one that is dangerous.

The extents in the DSS and the details for USSs are those of a corridor. Flights there are refused or return; where
flight is dangerous it is allowed.
"""

from __future__ import annotations

import json
from typing import Any

import skyrange.plugin as sky
from skyrange.attack.bases.approval import check_constraint_manager
from skyrange.attack.bases.corridor import InCorridor
from skyrange.codec.f3548.values import volume_body
from skyrange.utm.federated.names import AIRSPACE


@sky.attack(
    "approval.poisoned_constraint",
    technique="T0856",
    effect="flights in the corridor are refused, delayed or return; others fly where it is dangerous",
    knowledge="the interface of constraint managers (ASTM F3548-21)",
    position="the constraint manager, who has taken it over, or its network where TLS ends",
    equipment="its server",
    load="the sham: the same frames, of the same length, with the true volumes",
    content="none, because a constraint that is true is that of the sham",
    placement="a corridor where nobody flies",
)
class PoisonedConstraint(InCorridor):
    """Closes a corridor instead of the area that a constraint is about."""

    solid: dict[str, Any]
    """The false Volume3D."""

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """Taps at the constraint manager. Raises `InputError` for a scenario without one."""
        check_constraint_manager(context)
        self.solid = volume_body(self.make_volume(context.origin, 0, 1), context.epoch)["volume"]
        return self.at_service(AIRSPACE, context, alters="constraints")

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
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
