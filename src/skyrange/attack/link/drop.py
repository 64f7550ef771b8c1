"""Loss on a link: selected frames are dropped with a probability."""

from __future__ import annotations

from skyrange.attack.bases.frame_acts import drop
from skyrange.attack.bases.on_path import OnPath
from skyrange.attack.declaration import attack
from skyrange.attack.presets import adds_no_load, on_path
from skyrange.attack.tapped_links import EVERY_LINK
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param


@attack(
    "link.drop",
    technique="T0814",
    counterfactual="mute",
    surface=EVERY_LINK,
    persists="acts",
    effect="selected frames never arrive",
    threat=on_path("which messages to drop, from frames that are not encrypted"),
    controls=adds_no_load(
        content="none, because a dropped frame has no content; compare with the muted run",
        placement="the same loss on another aircraft's link, or of other messages",
    ),
)
class Loss(OnPath):
    """Drops selected frames of a link, all of them or some at random.

    Each selected frame is dropped with the same probability, independently of the others.
    """

    probability: Number = param(
        "Probability that a selected frame is dropped, more than 0 and at most 1.", default=1.0, gt=0, le=1
    )

    act = drop("probability")
