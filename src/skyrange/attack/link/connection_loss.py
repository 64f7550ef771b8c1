"""Connection loss: a link is down for stretches of time."""

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
from skyrange.core.time import Time, from_seconds

_DROP = (Drop(),)


class Outages(OnPath):
    """The link is down from the start of the attack on, then up, and so on by turns."""

    down_s: Number = Field(default=10.0, gt=0, le=86_400, description="Length of an outage in seconds.")
    up_s: Number = Field(default=20.0, ge=0, le=86_400, description="Time between two outages in seconds.")


@dataclass(slots=True)
class Breaker(FrameTap):
    """Drops the selected frames during outages of `down_ns`, which begin every `period_ns`."""

    down_ns: Time
    period_ns: Time

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Drop it during an outage."""
        return _DROP if (now - self.rule.start_ns) % self.period_ns < self.down_ns else ()


def make(params: Outages, context: AttackContext) -> Attack:
    """The attack. The sham breaks the link too, because no benign act takes a frame off a link."""
    down_ns = from_seconds(params.down_s)
    maker = TapMaker(Breaker, (rule_of(params, context), down_ns, down_ns + from_seconds(params.up_s)))
    return Attack(taps=place_taps(params.links, context, maker))


BREAK = AttackPlugin(
    Outages,
    make,
    "Takes a link down for stretches of time.",
    technique="T0814",
    counterfactual="mute",
    surface=EVERY_LINK,
    persists="acts",
    effect="the ends lose each other: failsafes for a lost link fire, and recover when it is back",
    threat=ThreatModel(
        knowledge="the length of the failsafes' timeouts",
        position="where it can cut the link: at a router, a cable, or a modem",
        equipment="a switch",
        budget="no frames of its own",
    ),
    controls=Controls(
        load="none, because it adds no load",
        content="none, because a dropped frame has no content; outages shorter than every timeout show the loss alone",
        placement="the same outages on another aircraft's link",
    ),
)
