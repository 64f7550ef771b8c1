"""Duplication on a link: copies of selected frames arrive some time after them."""

from __future__ import annotations

import skyrange.plugin as sky


@sky.attack(
    "link.duplicate",
    technique="T0830",
    intrudes=True,
    persists="mode",
    effect="receivers get frames a second time, and obey a command again that a later one replaced",
    knowledge="nothing for all frames; the message ids to select some",
    budget="up to 10 frames for each frame copied",
    load="the sham: benign frames of the same length in place of the copies",
    content="copies after 1 ms, before the next frame changes what they mean",
    placement="the same copies on another aircraft's link, or of other messages",
)
class Duplication(sky.OnPath):
    """Puts copies of selected frames on a link, some time after them."""

    after_s: sky.Number = sky.param(
        "Time in seconds from a frame to its copy, and from copy to copy.", default=0.5, ge=0.001, le=60
    )
    copies: sky.Whole = sky.param("Number of copies of a frame.", default=1, ge=1, le=10)
    probability: sky.Number = sky.param("Probability that a selected frame is copied.", default=1.0, gt=0, le=1)

    act = sky.duplicate("copies", "after_s", "probability")
