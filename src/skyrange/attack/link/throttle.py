"""Throttle on a link: its rate is limited, with a bounded queue."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.link.frame_taps import FrameTap, rule_of
from skyrange.attack.on_path import EVERY_LINK, OnPath, TapMaker, place_taps
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number, Whole
from skyrange.contracts.verdicts import Delay, Drop, Verdict
from skyrange.core.time import NS_PER_S, Time


class Throttle(OnPath):
    """The selected frames of each direction share a rate and a queue, as on a link with a rate limit. Other frames
    pass beside them.
    """

    rate_bps: Number = Field(
        default=9600.0, ge=1, le=1e12, description="Rate of each direction in bits per second, at least 1."
    )
    queue_bytes: Whole = Field(
        default=4096,
        ge=1,
        le=2**31,
        description="Size of the queue of each direction in bytes; a frame that does not fit is dropped.",
    )


@dataclass(slots=True)
class RateLimiter(FrameTap):
    """Serialises frames at `rate_bps`, as `Channel.rate_bps` and `Channel.queue_bytes` do."""

    rate_bps: float
    queue_bytes: int
    busy_until: dict[str, Time] = field(default_factory=dict)
    """When the queue of each direction is empty."""

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Delay it until it has been sent, or drop it where the queue is full."""
        waiting_ns = max(0, self.busy_until.get(frame.direction, 0) - now)
        size = len(frame.payload)
        if waiting_ns * self.rate_bps / (8 * NS_PER_S) + size > self.queue_bytes:
            return (Drop(),)
        ready = now + waiting_ns + math.ceil(size * 8 * NS_PER_S / self.rate_bps)
        self.busy_until[frame.direction] = ready
        return (Delay(ready),)


def make(params: Throttle, context: AttackContext) -> Attack:
    """The attack. The sham does the same, because no benign act makes a link slower."""
    arguments = (rule_of(params, context), params.rate_bps, params.queue_bytes)
    return Attack(taps=place_taps(params.links, context, TapMaker(RateLimiter, arguments)))


THROTTLE = AttackPlugin(
    Throttle,
    make,
    "Limits the rate of a link; frames wait in a bounded queue, and are dropped where it is full.",
    technique="T0814",
    counterfactual="mute",
    surface=EVERY_LINK,
    persists="acts",
    effect="frames queue, and are lost where the queue is full, the more so the more is sent",
    threat=ThreatModel(
        knowledge="nothing",
        position="on the path, such as a router or access point between ground station and aircraft",
        equipment="a computer that forwards the frames",
        budget="no frames of its own",
    ),
    controls=Controls(
        load="none, because it adds no load; a rate above that of the traffic has no effect",
        content="none, because it reads no content; link.delay with the mean delay has the delay without the loss",
        placement="the same rate on another aircraft's link",
    ),
)
