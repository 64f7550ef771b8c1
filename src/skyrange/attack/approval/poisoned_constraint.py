"""Poisoned constraint: who speaks for the constraint manager closes another area than the one that is dangerous."""

from __future__ import annotations

from typing import Any

import skyrange.plugin as sky
from skyrange.attack.bases.approval.federation import check_constraint_manager
from skyrange.attack.bases.approval.links import AltersMessages, InCorridor
from skyrange.codec.f3548.values import volume_body
from skyrange.utm.contract import AIRSPACE


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
class PoisonedConstraint(AltersMessages, InCorridor):
    """Closes a corridor instead of the area that a constraint is about.

    The extents in the DSS and the details for USSs are those of the corridor.
    """

    solid: dict[str, Any]
    """The false Volume3D."""

    def build(self, context: sky.AttackContext) -> sky.Attack:
        check_constraint_manager(context)
        self.solid = volume_body(self.make_volume(context.origin, 0, 1), context.epoch)["volume"]
        return self.at_service(AIRSPACE, context, alters="constraints")

    def alter(self, message: Any) -> None:
        """Replace the volumes of constraints, but not their times."""
        body = message.get("body") or {}
        for volume in body["extents"] if "extents" in body else body["constraint"]["details"]["volumes"]:
            volume["volume"] = self.solid
