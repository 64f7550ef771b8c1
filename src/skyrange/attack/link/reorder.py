"""Reordering on a link: some frames are held back, so that later ones overtake them."""

from __future__ import annotations

import skyrange.plugin as sky


@sky.attack(
    "link.reorder",
    technique="T0830",
    counterfactual="mute",
    effect="receivers take an older command or report for the newest",
    knowledge="nothing for all frames; the message ids to select some",
    equipment="a computer that forwards the frames, with memory for those that it holds",
    content="link.delay with as long a delay: the frames are as late, in their order",
    placement="the same reordering on another aircraft's link, or of other messages",
)
class Reordering(sky.OnPath):
    """Holds some frames of a link back, so that later ones overtake them.

    The sham holds the same frames back for 1 ns.
    """

    probability: sky.Number = sky.param("Probability that a selected frame is held back.", default=0.3, gt=0, le=1)
    hold_s: sky.Number = sky.param(
        "Longest hold in seconds; holds are uniform from half of it to all of it.", default=1.0, ge=0.001, le=600
    )

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        chosen, share, _, _ = self.draw(frame)
        if chosen >= self.probability:
            return ()
        hold_ns = 1 if self.sham else sky.from_seconds(self.hold_s)
        return (sky.Delay(now + max(1, int(hold_ns * (0.5 + 0.5 * share)))),)
