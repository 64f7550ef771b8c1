"""Adversary of a campaign: an object that observes, and decides which acts act.

The campaign calls it with every frame on a link that it taps, with every Remote ID broadcast that its radio decodes,
and 20 times a second. It has nothing else: no truth.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from skyrange.core.time import Time


@dataclass(frozen=True, slots=True)
class Observation:
    """A frame that the adversary has read or received."""

    payload: bytes
    """A MAVLink frame of a tapped link, or a Remote ID broadcast as it is on `rid_down` links."""
    link: str | None = None
    """The tapped link, such as `gcs:blue/b1`; `None` for a broadcast."""
    direction: str = "rev"
    """On a tapped link: `fwd` towards the aircraft, `rev` from it."""

    @property
    def vehicle(self) -> str:
        """The aircraft of the tapped link, such as `blue/b1`; "" for a broadcast."""
        return "" if self.link is None else self.link.partition(":")[2]


@dataclass(frozen=True, slots=True)
class CampaignStage:
    """A state of the adversary: its name, in events of the record, and the names of the acts that act in it."""

    name: str
    acts: Collection[str] = ()


@runtime_checkable
class Adversary(Protocol):
    """Decides on the acts of a campaign by what it observes.

    It can be deep-copied (no generators, no closures), takes no random numbers other than from `AttackContext.chance`,
    and reads no clock but `now`.
    """

    def observe(self, now: Time, observation: Observation) -> None:
        """Learn from a frame. It is called from the start of the run, also before the campaign starts, and muted."""
        ...

    def decide(self, now: Time) -> CampaignStage | None:
        """The stage from `now` on; `None` ends the campaign.

        It is called from the start of the campaign on: after each observation and every 50 ms, and again at once when
        it has answered with another stage than before. Acts of the stage start unless they act already, and all others
        stop. An act that has stopped cannot start again.
        """
        ...
