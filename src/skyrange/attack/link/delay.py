"""Delay on a link: selected frames arrive later, in their order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.link.frame_taps import FrameTap, rule_of
from skyrange.attack.on_path import EVERY_LINK, OnPath, TapMaker, place_taps
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number
from skyrange.contracts.verdicts import Delay, Verdict
from skyrange.core.time import NS_PER_US, Time, from_seconds

SHAM_NS = NS_PER_US
"""Delay of the sham."""


class Lag(OnPath):
    """Each selected frame is delayed by a constant and a random part. The selected frames of a direction keep their
    order; frames that are not selected overtake them.
    """

    delay_s: Number = Field(default=1.0, gt=0, le=600, description="Constant delay of a frame in seconds.")
    jitter_s: Number = Field(
        default=0.0, ge=0, le=600, description="Range of the extra delay in seconds, uniform from 0 to this value."
    )


@dataclass(slots=True)
class Delayer(FrameTap):
    """Delays each selected frame by `delay_ns` and up to `jitter_ns` more."""

    delay_ns: Time
    jitter_ns: Time
    last: dict[str, Time] = field(default_factory=dict)
    """Until when the last frame of each direction is held."""

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Delay it."""
        until = now + self.delay_ns
        if self.jitter_ns:
            until += int(self.rule.chance.draw(frame)[0] * self.jitter_ns)
        until = max(until, self.last.get(frame.direction, until))
        self.last[frame.direction] = until
        return (Delay(until),)


def make(params: Lag, context: AttackContext) -> Attack:
    """The attack; its sham delays by 1 µs."""
    times = (from_seconds(params.delay_s), from_seconds(params.jitter_s))
    maker = TapMaker(Delayer, (rule_of(params, context), *((SHAM_NS, 0) if context.sham else times)))
    return Attack(taps=place_taps(params.links, context, maker))


DELAY = AttackPlugin(
    Lag,
    make,
    "Delays selected frames of a link by a constant and a random time.",
    technique="T0830",
    counterfactual="mute",
    surface=EVERY_LINK,
    persists="acts",
    effect="commands and reports arrive late, in their order",
    threat=ThreatModel(
        knowledge="nothing for all frames; the message ids to select some",
        position="on the path, such as a router between ground station and aircraft",
        equipment="a computer that forwards the frames, with memory for those that it holds",
        budget="no frames of its own",
    ),
    controls=Controls(
        load="none, because it adds no load",
        content="the sham: the same frames, delayed by 1 µs",
        placement="the same delay on another aircraft's link, or of other messages",
    ),
)
