"""Reordering on a link: some frames are held back, so that later ones overtake them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.link.frame_taps import FrameTap, rule_of
from skyrange.attack.on_path import EVERY_LINK, OnPath, TapMaker, place_taps
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number
from skyrange.contracts.verdicts import Delay, Verdict
from skyrange.core.time import Time, from_seconds


class Reordering(OnPath):
    """Some of the selected frames are held back; all others pass and overtake them."""

    probability: Number = Field(
        default=0.3,
        gt=0,
        le=1,
        description="Probability that a selected frame is held back, more than 0 and at most 1.",
    )
    hold_s: Number = Field(
        default=1.0,
        ge=0.001,
        le=600,
        description="Longest time in seconds for which a frame is held back; the time is uniform from half of it to "
        "all of it.",
    )


@dataclass(slots=True)
class Reorderer(FrameTap):
    """Holds a selected frame back with `probability`, for `hold_ns` / 2 … `hold_ns`."""

    probability: float
    hold_ns: Time

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Hold it back, or let it pass."""
        chosen, share, _, _ = self.rule.chance.draw(frame)
        if chosen >= self.probability:
            return ()
        return (Delay(now + max(1, int(self.hold_ns * (0.5 + 0.5 * share)))),)


def make(params: Reordering, context: AttackContext) -> Attack:
    """The attack; its sham holds the same frames back for 1 ns."""
    arguments = (rule_of(params, context), params.probability, 1 if context.sham else from_seconds(params.hold_s))
    return Attack(taps=place_taps(params.links, context, TapMaker(Reorderer, arguments)))


REORDER = AttackPlugin(
    Reordering,
    make,
    "Holds some frames of a link back, so that later ones overtake them.",
    technique="T0830",
    counterfactual="mute",
    surface=EVERY_LINK,
    persists="acts",
    effect="receivers take an older command or report for the newest",
    threat=ThreatModel(
        knowledge="nothing for all frames; the message ids to select some",
        position="on the path, such as a router between ground station and aircraft",
        equipment="a computer that forwards the frames, with memory for those that it holds",
        budget="no frames of its own",
    ),
    controls=Controls(
        load="none, because it adds no load",
        content="link.delay with as long a delay: the frames are as late, in their order",
        placement="the same reordering on another aircraft's link, or of other messages",
    ),
)
