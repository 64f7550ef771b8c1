"""Connection loss: a link is down for stretches of time."""

from __future__ import annotations

from skyrange.attack.bases.on_path import OnPath
from skyrange.attack.contract import AttackContext
from skyrange.attack.declaration import attack
from skyrange.attack.presets import adds_no_load, on_path
from skyrange.attack.tapped_links import EVERY_LINK
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.contracts.verdicts import Drop, Verdicts
from skyrange.core.time import Time, from_seconds


@attack(
    "link.break",
    technique="T0814",
    counterfactual="mute",
    surface=EVERY_LINK,
    persists="acts",
    effect="the ends lose each other: failsafes for a lost link fire, and recover when it is back",
    threat=on_path(
        "the length of the failsafes' timeouts",
        position="where it can cut the link: at a router, a cable, or a modem",
        equipment="a switch",
    ),
    controls=adds_no_load(
        content="none, because a dropped frame has no content; outages shorter than every timeout show the loss alone",
        placement="the same outages on another aircraft's link",
    ),
)
class Outages(OnPath):
    """Takes a link down for stretches of time.

    The link is down from the start of the attack on, then up, and so on by turns. The sham breaks it too, because no
    benign act takes a frame off a link.
    """

    down_s: Number = param("Length of an outage in seconds.", default=10.0, gt=0, le=86_400)
    up_s: Number = param("Time between two outages in seconds.", default=20.0, ge=0, le=86_400)

    down_ns: Time
    period_ns: Time

    def prepare(self, context: AttackContext) -> None:
        """Set the times."""
        self.down_ns = from_seconds(self.down_s)
        self.period_ns = self.down_ns + from_seconds(self.up_s)

    def act(self, now: Time, frame: Frame) -> Verdicts:
        """Drop it during an outage."""
        return (Drop(),) if (now - self.schedule.start_ns) % self.period_ns < self.down_ns else ()
