"""What must a flight approval decide, and about what? An operational intent in, a decision out.

Words are those of ASTM F3548-21: an *operational intent* claims 4-D volumes; an accepted one gets an
*OVN* (opaque version number), which names the version that was accepted.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import blake2b
from typing import Protocol

from skyrange.core.time import Time
from skyrange.core.volumes import Volume4D


@dataclass(frozen=True, slots=True)
class Intent:
    """One operational intent: `operator` asks to fly `vehicle` through `volumes`, in the order flown.

    `id` is a UUID (see `intent_id`); `vehicle` a vehicle id (`blue/b1`); `priority` follows F3548
    (0 is routine, higher outranks).
    """

    id: str
    operator: str
    vehicle: str
    volumes: tuple[Volume4D, ...]
    priority: int = 0


@dataclass(frozen=True, slots=True)
class Decision:
    """What the approval says: accepted with an `ovn`, or rejected with a `reason` and perhaps `alternatives`."""

    accepted: bool
    reason: str = ""
    alternatives: tuple[Volume4D, ...] = ()
    ovn: str = ""


class Approval(Protocol):
    """Decides on intents. Registered by entry point in the group `skyrange.approvals`.

    Same calls in the same order, same answers: no clock, no socket. Its state is deep-copyable data.
    """

    def decide(self, now: Time, request: Intent) -> Decision:
        """Accept or reject `request` at `now`; called once per distinct request, in order of arrival."""
        ...


def intent_id(vehicle: str, version: int = 0) -> str:
    """A UUID for the `version`-th intent of a vehicle, the same in every run.

    Its form is that of version 4, as F3548-21's EntityID asks (RFC 9562, 5.4); its bits come from
    BLAKE2b of the name, since a random one would differ between twins.
    """
    raw = bytearray(blake2b(f"{vehicle}#{version}".encode(), digest_size=16).digest())
    raw[6] = raw[6] & 0x0F | 0x40
    raw[8] = raw[8] & 0x3F | 0x80
    text = raw.hex()
    return f"{text[:8]}-{text[8:12]}-{text[12:16]}-{text[16:20]}-{text[20:]}"
