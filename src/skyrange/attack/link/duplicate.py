"""Duplication on a link: copies of selected frames arrive some time after them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.link.frame_taps import MAX_INJECTS, FrameTap, benign_payload, inject_again, rule_of
from skyrange.attack.on_path import EVERY_LINK, OnPath, TapMaker, place_taps
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number, Whole
from skyrange.contracts.verdicts import Inject, Verdict
from skyrange.core.time import NEVER, Time, from_seconds


class Duplication(OnPath):
    """Each selected frame passes, and copies of it follow."""

    after_s: Number = Field(
        default=0.5, ge=0.001, le=60, description="Time in seconds from a frame to its copy, and from copy to copy."
    )
    copies: Whole = Field(default=1, ge=1, le=10, description="Number of copies of a frame.")
    probability: Number = Field(
        default=1.0, gt=0, le=1, description="Probability that a selected frame is copied, more than 0 and at most 1."
    )


@dataclass(slots=True)
class Duplicator(FrameTap):
    """Copies selected frames, and puts the copies on the link when they are due."""

    after_ns: Time
    copies: int
    probability: float
    waiting: list[tuple[Time, int, Inject]] = field(default_factory=list)
    """A heap: when a copy is due, its number, and the copy."""
    made: int = 0
    woken_ns: Time = -NEVER

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Let it pass, and keep copies."""
        if self.probability < 1.0 and self.rule.chance.draw(frame)[0] >= self.probability:
            return ()
        copy = inject_again(frame, benign_payload(frame.payload) if self.rule.sham else frame.payload)
        for turn in range(1, self.copies + 1):
            heappush(self.waiting, (now + turn * self.after_ns, self.made, copy))
            self.made += 1
        return ()

    def next_wakeup(self) -> Time | None:
        """When the next copy is due."""
        return max(self.waiting[0][0], self.woken_ns + 1) if self.waiting else None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """The copies that are due."""
        self.woken_ns = now
        due: list[Verdict] = []
        while self.waiting and self.waiting[0][0] <= now and len(due) < MAX_INJECTS:
            due.append(heappop(self.waiting)[2])
        return due


def make(params: Duplication, context: AttackContext) -> Attack:
    """The attack; its sham sends benign frames of the same length in place of the copies."""
    arguments = (rule_of(params, context), from_seconds(params.after_s), params.copies, params.probability)
    return Attack(taps=place_taps(params.links, context, TapMaker(Duplicator, arguments)))


DUPLICATE = AttackPlugin(
    Duplication,
    make,
    "Puts copies of selected frames on a link, some time after them.",
    technique="T0830",
    surface=EVERY_LINK,
    persists="mode",
    effect="receivers get frames a second time, and obey a command again that a later one replaced",
    threat=ThreatModel(
        knowledge="nothing for all frames; the message ids to select some",
        position="on the path, such as a router between ground station and aircraft",
        equipment="a computer that forwards the frames",
        budget="up to 10 frames for each frame copied",
    ),
    controls=Controls(
        load="the sham: benign frames of the same length in place of the copies",
        content="copies after 1 ms, before the next frame changes what they mean",
        placement="the same copies on another aircraft's link, or of other messages",
    ),
)
