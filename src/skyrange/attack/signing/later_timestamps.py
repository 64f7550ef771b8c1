"""Timestamps of forged signatures: later than those of all frames that passed, as a receiver wants them."""

from __future__ import annotations

from dataclasses import dataclass

from skyrange.attack.bases.mavlink.compromised_sender import read_timestamp
from skyrange.codec.mavlink.signing import LAST_TIMESTAMP, UNIT_NS
from skyrange.core.time import Time


@dataclass(slots=True)
class LaterTimestamps:
    """The latest timestamp that was seen, and the next one."""

    initial: int
    """Timestamp at time 0 by the attacker's clock."""
    latest: int = 0
    """The latest timestamp that passed or was taken."""

    def see(self, frame: bytes) -> None:
        """Learn from a frame that passes."""
        self.latest = max(self.latest, read_timestamp(frame) or 0)

    def take(self, now: Time) -> int:
        """The timestamp of the next forged frame."""
        self.latest = min(max(self.latest + 1, self.initial + now // UNIT_NS), LAST_TIMESTAMP)
        return self.latest
