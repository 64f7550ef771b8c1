"""Bursts of packet loss: a link that is good and bad by turns, after Gilbert and Elliott, in continuous time."""

from __future__ import annotations

from typing import Final

import skyrange.plugin as sky
from skyrange.core.elementary import log1p

STREAM: Final = "fault.link_loss"


@sky.fault(
    "link.loss",
    surface=sky.EVERY_LINK,
    effect="frames are lost in bursts: telemetry has gaps, and commands are repeated",
    cause="fading, interference from other users of the band, or a full queue in a network",
    not_modelled="delay: frames that arrive are as early as before",
    realism={
        "lengths of bursts and gaps": "cited: a link with two states (Gilbert 1960, Elliott 1963), in continuous time",
        "probability of loss": "assumed: the same for frames of every size, none in the good state",
    },
)
class LossBursts(sky.OnLinks):
    """Loses frames of links in bursts.

    The link is bad at the start of the fault, then good, and so on by turns. Times in each state are exponential
    (Gilbert, Capacity of a burst-noise channel, Bell System Technical Journal 39, 1960; Elliott, 42, 1963, have
    geometric ones for frames in slots). The n-th of a link depends on fault, link and n alone, whatever is sent.
    """

    burst_s: sky.Number = sky.param("Mean time in seconds that the link is bad.", default=2.0, gt=0, le=3_600)
    gap_s: sky.Number = sky.param("Mean time in seconds that it is good in between.", default=4.0, gt=0, le=3_600)
    loss: sky.Number = sky.param("Probability that a frame is lost while it is bad.", default=0.7, gt=0, le=1)
    number: int = -1
    """Of the state that the link is in; even numbers are bad."""
    until: sky.Time = 0

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        if self.number < 0:
            self.until = self.schedule.start_ns
        while now >= self.until:
            self.number += 1
            self.until += self._duration_ns(self.number)
        return () if self.number % 2 or self.draw(frame)[0] >= self.loss else (sky.Drop(),)

    def _duration_ns(self, number: int) -> sky.Time:
        """How long the n-th state lasts, at least 1 ns."""
        uniform = self.chance.uniform4(STREAM, sky.hash64(f"{self.id}|{self.link}"), 0, number)[0]
        return max(1, round(-log1p(-uniform) * sky.from_seconds(self.gap_s if number % 2 else self.burst_s)))
