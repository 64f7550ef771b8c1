"""Throttle on a link: its rate is limited, with a bounded queue."""

from __future__ import annotations

import math

from skyrange.attack.bases.on_path import OnPath
from skyrange.attack.contract import Controls
from skyrange.attack.declaration import attack
from skyrange.attack.presets import on_path
from skyrange.attack.tapped_links import EVERY_LINK
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number, Whole
from skyrange.contracts.plugins.fields import param, state
from skyrange.contracts.verdicts import Delay, Drop, Verdicts
from skyrange.core.time import NS_PER_S, Time


@attack(
    "link.throttle",
    technique="T0814",
    counterfactual="mute",
    surface=EVERY_LINK,
    persists="acts",
    effect="frames queue, and are lost where the queue is full, the more so the more is sent",
    threat=on_path(
        "nothing", position="on the path, such as a router or access point between ground station and aircraft"
    ),
    controls=Controls(
        load="none, because it adds no load; a rate above that of the traffic has no effect",
        content="none, because it reads no content; link.delay with the mean delay has the delay without the loss",
        placement="the same rate on another aircraft's link",
    ),
)
class Throttle(OnPath):
    """Limits the rate of a link; frames wait in a bounded queue, and are dropped where it is full.

    The selected frames of each direction share a rate and a queue, as `Channel.rate_bps` and `Channel.queue_bytes` of a
    link do. Other frames pass beside them. The sham does the same, because no benign act makes a link slower.
    """

    rate_bps: Number = param("Rate of each direction in bits per second, at least 1.", default=9600.0, ge=1, le=1e12)
    queue_bytes: Whole = param(
        "Size of the queue of each direction in bytes; a frame that does not fit is dropped.",
        default=4096, ge=1, le=2**31,
    )  # fmt: skip
    busy_until: dict[str, Time] = state(dict)
    """When the queue of each direction is empty."""

    def act(self, now: Time, frame: Frame) -> Verdicts:
        """Delay it until it has been sent, or drop it where the queue is full."""
        waiting_ns = max(0, self.busy_until.get(frame.direction, 0) - now)
        size = len(frame.payload)
        if waiting_ns * self.rate_bps / (8 * NS_PER_S) + size > self.queue_bytes:
            return (Drop(),)
        ready = now + waiting_ns + math.ceil(size * 8 * NS_PER_S / self.rate_bps)
        self.busy_until[frame.direction] = ready
        return (Delay(ready),)
