"""Disabled avoidance: the companion hears other aircraft and decides to avoid, and its orders never leave it."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.compromised_sender import CompromisedCompanion


@sky.attack(
    "companion.no_avoidance",
    technique="T0837",
    intrudes=False,
    effect="the aircraft does not avoid those that it hears, and its telemetry and broadcasts look normal",
    knowledge="the messages by which a companion commands its autopilot",
    budget="no frames of its own; it alters some frames in each avoidance",
    load="the sham: the same frames are replaced by copies of themselves",
    content="none, because an order that is held back has no content",
)
class DisabledAvoidance(CompromisedCompanion):
    """Holds back the orders by which a companion computer avoids others, and nothing else."""

    holds_back = "companion"
