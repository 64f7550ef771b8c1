"""Loss on a link: selected frames are dropped with a probability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.link.frame_taps import FrameTap, rule_of
from skyrange.attack.on_path import EVERY_LINK, OnPath, TapMaker, place_taps
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number
from skyrange.contracts.verdicts import Drop, Verdict
from skyrange.core.time import Time

_DROP = (Drop(),)


class Loss(OnPath):
    """Each selected frame is dropped with the same probability, independently of the others."""

    probability: Number = Field(
        default=1.0, gt=0, le=1, description="Probability that a selected frame is dropped, more than 0 and at most 1."
    )


@dataclass(slots=True)
class Dropper(FrameTap):
    """Drops each selected frame with `probability`."""

    probability: float

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Drop it, or let it pass."""
        if self.probability < 1.0 and self.rule.chance.draw(frame)[0] >= self.probability:
            return ()
        return _DROP


def make(params: Loss, context: AttackContext) -> Attack:
    """The attack. The sham drops the same frames, because no benign act takes a frame off a link."""
    maker = TapMaker(Dropper, (rule_of(params, context), params.probability))
    return Attack(taps=place_taps(params.links, context, maker))


DROP = AttackPlugin(
    Loss,
    make,
    "Drops selected frames of a link, all of them or some at random.",
    technique="T0814",
    counterfactual="mute",
    surface=EVERY_LINK,
    persists="acts",
    effect="selected frames never arrive",
    threat=ThreatModel(
        knowledge="which messages to drop, from frames that are not encrypted",
        position="on the path, such as a router between ground station and aircraft",
        equipment="a computer that forwards the frames",
        budget="no frames of its own",
    ),
    controls=Controls(
        load="none, because it adds no load",
        content="none, because a dropped frame has no content; compare with the muted run",
        placement="the same loss on another aircraft's link, or of other messages",
    ),
)
