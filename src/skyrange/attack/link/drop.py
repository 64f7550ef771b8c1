"""Loss on a link: selected frames are dropped with a probability."""

from __future__ import annotations

import skyrange.plugin as sky


@sky.attack(
    "link.drop",
    technique=sky.technique_by("direction", fwd="T0803", rev="T0804", both="T0814"),
    counterfactual="mute",
    effect="selected frames never arrive",
    knowledge="which messages to drop, from frames that are not encrypted",
    content="none, because a dropped frame has no content; compare with the muted run",
    placement="the same loss on another aircraft's link, or of other messages",
)
class Loss(sky.OnPath):
    """Drops selected frames of a link, all of them or some at random.

    Each selected frame is dropped with the same probability, independently of the others.
    """

    probability: sky.Number = sky.param("Probability that a selected frame is dropped.", default=1.0, gt=0, le=1)

    act = sky.drop("probability")
