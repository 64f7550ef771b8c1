"""Poisoned constraint: who speaks for the constraint manager closes another area than the one that is dangerous.

The extents in the DSS and the details for USSs are those of a corridor. Flights there are refused or return; where
flight is dangerous it is allowed.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from skyrange.attack.approval.claims import Stretch, make_prism
from skyrange.attack.approval.uss_links import check_constraint_manager, uss_taps
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import ScheduledTap, TapMaker
from skyrange.codec.f3548.values import volume_body
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.verdicts import Replace, Verdict
from skyrange.core.time import Time
from skyrange.utm.federated.names import AIRSPACE


class PoisonedConstraint(Stretch):
    """The corridor that is closed instead."""


@dataclass(slots=True)
class PoisoningTap(ScheduledTap):
    """Replaces the volumes of constraints that leave the constraint manager; the sham leaves them as they are."""

    solid: dict[str, Any]
    """The false Volume3D."""
    sham: bool

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Replace volumes, but not their times."""
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
        false = json.dumps(message, sort_keys=True, separators=(",", ":")).encode()
        length = max(len(false), len(frame.payload))
        return [Replace((frame.payload if self.sham else false).ljust(length))]


def make(params: PoisonedConstraint, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for a scenario without a constraint manager."""
    check_constraint_manager(context)
    solid = volume_body(make_prism(params, context.origin, 0, 1), context.epoch)["volume"]
    maker = TapMaker(PoisoningTap, (context.schedule, solid, context.sham))
    return Attack(taps=uss_taps(AIRSPACE, context, maker), exclusive=[Exclusive("constraints")])


POISONED_CONSTRAINT = AttackPlugin(
    PoisonedConstraint,
    make,
    "Closes a corridor instead of the area that a constraint is about.",
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
    controls=Controls(
        load="the sham: the same frames, of the same length, with the true volumes",
        content="none, because a constraint that is true is that of the sham",
        placement="a corridor where nobody flies",
    ),
)
