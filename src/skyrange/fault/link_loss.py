"""Bursts of packet loss: a link that is good and bad by turns, after Gilbert and Elliott, in continuous time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import log1p
from typing import Final

from pydantic import Field

from skyrange.attack.link.frame_taps import FrameTap
from skyrange.attack.on_path import EVERY_LINK, TapMaker, place_taps
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number
from skyrange.contracts.verdicts import Drop, Verdict
from skyrange.core.ids import hash64
from skyrange.core.time import Time, from_seconds
from skyrange.fault.contract import FaultContext, FaultParts, FaultPlugin
from skyrange.fault.links import Links, rule_for

STREAM: Final = "fault.link_loss"
_DROP: Final = (Drop(),)


class LossBursts(Links):
    """The link is bad at the start of the fault, then good, and so on by turns, for times drawn at random."""

    burst_s: Number = Field(default=2.0, gt=0, le=3_600, description="Mean time in seconds that the link is bad.")
    gap_s: Number = Field(
        default=4.0, gt=0, le=3_600, description="Mean time in seconds that it is good between two bursts."
    )
    loss: Number = Field(
        default=0.7, gt=0, le=1, description="Probability that a frame is lost while the link is bad, above 0 to 1."
    )


@dataclass(slots=True)
class BurstyLink(FrameTap):
    """Drops frames while the link is bad.

    Times in each state are exponential (Gilbert, Capacity of a burst-noise channel, Bell System Technical Journal 39,
    1960; Elliott, 42, 1963, have geometric ones for frames in slots). The n-th of a link depends on fault, link and n
    alone, whatever is sent.
    """

    loss: float
    burst_ns: Time
    gap_ns: Time
    _number: int = field(default=-1, init=False)
    _until: Time = field(default=0, init=False)

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Drop it, with the probability of a bad link."""
        if self._number < 0:
            self._until = self.rule.start_ns
        while now >= self._until:
            self._number += 1
            self._until += self._duration_ns(self._number)
        if self._number % 2:
            return ()
        return _DROP if self.rule.chance.draw(frame)[0] < self.loss else ()

    def _duration_ns(self, number: int) -> Time:
        """How long the n-th state lasts, at least 1 ns; even numbers are bad."""
        chance = self.rule.chance
        uniform = chance.chance.uniform4(STREAM, hash64(f"{chance.attack}|{self.link}"), 0, number)[0]
        mean_ns = self.gap_ns if number % 2 else self.burst_ns
        return max(1, round(-log1p(-uniform) * mean_ns))


def make(params: LossBursts, context: FaultContext) -> FaultParts:
    """The parts. Raises `InputError` for links that the scenario does not have."""
    times = (from_seconds(params.burst_s), from_seconds(params.gap_s))
    maker = TapMaker(BurstyLink, (rule_for(context, params.direction), params.loss, *times))
    return FaultParts(taps=place_taps(params.links, context, maker))


LINK_LOSS = FaultPlugin(
    LossBursts,
    make,
    "Loses frames of links in bursts.",
    surface=EVERY_LINK,
    effect="frames are lost in bursts: telemetry has gaps, and commands are repeated",
    cause="fading, interference from other users of the band, or a full queue in a network",
    not_modelled="delay: frames that arrive are as early as before",
    realism={
        "lengths of bursts and gaps": "cited: a link with two states (Gilbert 1960, Elliott 1963), in continuous time",
        "probability of loss": "assumed: the same for frames of every size, none in the good state",
    },
)
