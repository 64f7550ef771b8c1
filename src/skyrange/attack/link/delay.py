"""Delay on a link: selected frames arrive later, in their order."""

from __future__ import annotations

import skyrange.plugin as sky


@sky.attack(
    "link.delay",
    technique="T0830",
    counterfactual="mute",
    effect="commands and reports arrive late, in their order",
    knowledge="nothing for all frames; the message ids to select some",
    equipment="a computer that forwards the frames, with memory for those that it holds",
    content="the sham: the same frames, delayed by 1 µs",
    placement="the same delay on another aircraft's link, or of other messages",
)
class Lag(sky.OnPath):
    """Delays selected frames of a link by a constant and a random time.

    The selected frames of a direction keep their order; frames that are not selected overtake them.
    """

    delay_s: sky.Number = sky.param("Constant delay of a frame in seconds.", default=1.0, gt=0, le=600)
    jitter_s: sky.Number = sky.param("Longest extra delay in seconds, uniform from 0.", default=0.0, ge=0, le=600)

    act = sky.delay("delay_s", "jitter_s")
