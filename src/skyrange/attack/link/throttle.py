"""Throttle on a link: its rate is limited, with a bounded queue."""

from __future__ import annotations

import math

import skyrange.plugin as sky


@sky.attack(
    "link.throttle",
    technique="T0814",
    counterfactual="mute",
    effect="frames queue, and are lost where the queue is full, the more so the more is sent",
    knowledge="nothing",
    position="on the path, such as a router or access point between ground station and aircraft",
    load="none, because it adds no load; a rate above that of the traffic has no effect",
    content="none, because it reads no content; link.delay with the mean delay has the delay without the loss",
    placement="the same rate on another aircraft's link",
)
class Throttle(sky.OnPath):
    """Limits the rate of a link; frames wait in a bounded queue, and are dropped where it is full.

    The selected frames of each direction share a rate and a queue, as `Channel.rate_bps` and `Channel.queue_bytes` of a
    link do. Other frames pass beside them. The sham does the same, because no benign act makes a link slower.
    """

    rate_bps: sky.Number = sky.param("Rate of each direction in bits per second.", default=9600.0, ge=1, le=1e12)
    queue_bytes: sky.Whole = sky.param("Size of the queue of each direction in bytes.", default=4096, ge=1, le=2**31)

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        flow, size = (frame.link, frame.direction), len(frame.payload)
        waiting_ns = max(0, self.delayed_until.get(flow, 0) - now)
        if waiting_ns * self.rate_bps / (8 * sky.NS_PER_S) + size > self.queue_bytes:
            return (sky.Drop(),)
        ready = now + waiting_ns + math.ceil(size * 8 * sky.NS_PER_S / self.rate_bps)
        self.delayed_until[flow] = ready
        return (sky.Delay(ready),)
