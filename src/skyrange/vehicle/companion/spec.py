"""Companion specification: what a companion is told of its aircraft before the run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from skyrange.codec.mavlink.signing import SigningKey
from skyrange.remoteid.broadcast_profiles import Broadcast
from skyrange.vehicle.avoidance.contract import Avoidance

if TYPE_CHECKING:  # its imports are slow, and only receivers that verify need them
    from skyrange.remoteid.drip.verification.verdicts import Verification


@dataclass(frozen=True, slots=True)
class CompanionSpec:
    """One aircraft: its MAVLink system id, what it broadcasts, and how it avoids others (None: not at all)."""

    vehicle: str
    system_id: int
    broadcast: Broadcast
    avoidance: Avoidance | None = None
    cruise_mps: float = 10.0
    """The mission's ground speed, kept during and after avoidance."""
    signing_key: SigningKey | None = field(default=None, repr=False)
    """The autopilot's key, if its MAVLink is signed: the companion signs its commands and verifies what it receives."""
    verification: Verification | None = None
    """How it verifies the Remote ID of others; None: not at all."""
