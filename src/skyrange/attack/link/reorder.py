"""Reordering on a link: some frames are held back, so that later ones overtake them."""

from __future__ import annotations

from skyrange.attack.bases.on_path import OnPath
from skyrange.attack.contract import AttackContext
from skyrange.attack.declaration import attack
from skyrange.attack.presets import FORWARDS_AND_HOLDS, adds_no_load, on_path
from skyrange.attack.tapped_links import EVERY_LINK
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.contracts.verdicts import Delay, Verdicts
from skyrange.core.time import Time, from_seconds


@attack(
    "link.reorder",
    technique="T0830",
    counterfactual="mute",
    surface=EVERY_LINK,
    persists="acts",
    effect="receivers take an older command or report for the newest",
    threat=on_path("nothing for all frames; the message ids to select some", equipment=FORWARDS_AND_HOLDS),
    controls=adds_no_load(
        content="link.delay with as long a delay: the frames are as late, in their order",
        placement="the same reordering on another aircraft's link, or of other messages",
    ),
)
class Reordering(OnPath):
    """Holds some frames of a link back, so that later ones overtake them.

    The sham holds the same frames back for 1 ns.
    """

    probability: Number = param(
        "Probability that a selected frame is held back, more than 0 and at most 1.", default=0.3, gt=0, le=1
    )
    hold_s: Number = param(
        "Longest time in seconds for which a frame is held back; the time is uniform from half of it to all of it.",
        default=1.0, ge=0.001, le=600,
    )  # fmt: skip

    hold_ns: Time

    def prepare(self, context: AttackContext) -> None:
        """Set the time."""
        self.hold_ns = 1 if self.sham else from_seconds(self.hold_s)

    def act(self, now: Time, frame: Frame) -> Verdicts:
        """Hold it back, or let it pass."""
        chosen, share, _, _ = self.draw(frame)
        if chosen >= self.probability:
            return ()
        return (Delay(now + max(1, int(self.hold_ns * (0.5 + 0.5 * share)))),)
