"""Delay on a link: selected frames arrive later, in their order."""

from __future__ import annotations

from skyrange.attack.bases.frame_acts import SHAM_NS, delay
from skyrange.attack.bases.on_path import OnPath
from skyrange.attack.contract import AttackContext
from skyrange.attack.declaration import attack
from skyrange.attack.presets import FORWARDS_AND_HOLDS, adds_no_load, on_path
from skyrange.attack.tapped_links import EVERY_LINK
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param, state
from skyrange.core.time import Time, from_seconds


@attack(
    "link.delay",
    technique="T0830",
    counterfactual="mute",
    surface=EVERY_LINK,
    persists="acts",
    effect="commands and reports arrive late, in their order",
    threat=on_path("nothing for all frames; the message ids to select some", equipment=FORWARDS_AND_HOLDS),
    controls=adds_no_load(
        content="the sham: the same frames, delayed by 1 µs",
        placement="the same delay on another aircraft's link, or of other messages",
    ),
)
class Lag(OnPath):
    """Delays selected frames of a link by a constant and a random time.

    The selected frames of a direction keep their order; frames that are not selected overtake them.
    """

    delay_s: Number = param("Constant delay of a frame in seconds.", default=1.0, gt=0, le=600)
    jitter_s: Number = param(
        "Range of the extra delay in seconds, uniform from 0 to this value.", default=0.0, ge=0, le=600
    )
    delay_ns: Time
    jitter_ns: Time
    last: dict[str, Time] = state(dict)

    act = delay("delay_ns", "jitter_ns")

    def prepare(self, context: AttackContext) -> None:
        """Set the times; the sham delays by 1 µs."""
        self.delay_ns, self.jitter_ns = from_seconds(self.delay_s), from_seconds(self.jitter_s)
        if self.sham:
            self.delay_ns, self.jitter_ns = SHAM_NS, 0
