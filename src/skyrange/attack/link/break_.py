"""Connection loss: a link is down for stretches of time."""

from __future__ import annotations

import skyrange.plugin as sky


@sky.attack(
    "link.break",
    technique="T0814",
    counterfactual="mute",
    effect="the ends lose each other: failsafes for a lost link fire, and recover when it is back",
    knowledge="the length of the failsafes' timeouts",
    position="where it can cut the link: at a router, a cable, or a modem",
    equipment="a switch",
    content="none, because a dropped frame has no content; outages shorter than every timeout show the loss alone",
    placement="the same outages on another aircraft's link",
)
class Outages(sky.OnPath):
    """Takes a link down for stretches of time.

    The link is down from the start of the attack on, then up, and so on by turns. The sham breaks it too, because no
    benign act takes a frame off a link.
    """

    down_s: sky.Number = sky.param("Length of an outage in seconds.", default=10.0, gt=0, le=86_400)
    up_s: sky.Number = sky.param("Time between two outages in seconds.", default=20.0, ge=0, le=86_400)

    down_ns: sky.Time
    period_ns: sky.Time

    def prepare(self, context: sky.AttackContext) -> None:
        self.down_ns = sky.from_seconds(self.down_s)
        self.period_ns = self.down_ns + sky.from_seconds(self.up_s)

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        return (sky.Drop(),) if (now - self.schedule.start_ns) % self.period_ns < self.down_ns else ()
