"""Eavesdropping on a link: what frames tell of aircraft and missions is recorded, and nothing is altered."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.link.overheard import Overheard
from skyrange.attack.tapped_links import LEARNED


@sky.attack(
    "link.eavesdrop",
    technique="T0842",
    counterfactual="mute",
    surface=("gcs", "log", "autopilot", "rid_data"),
    effect="nothing changes for its victims; the attacker knows positions, missions, parameters and system ids",
    knowledge="MAVLink, which is public",
    position="by place: on the path, or within range of both ends of a Wi-Fi link that is not encrypted",
    equipment="a computer that forwards or receives the frames",
    budget="none: it sends nothing",
    load="none, because it sends nothing",
    content="none, because it sends nothing; the sham notes nothing",
    placement="the same on a link whose frames are of another aircraft",
)
class Eavesdropping(sky.InAir, sky.OnPath):  # type: ignore[misc]  # more places than its base
    """Reads the frames of a link and records what they tell; it alters nothing.

    In the air it reads a frame if it decodes one of its transmissions, and the link is not encrypted or it has the key.
    A fact is noted when it is learnt, and when it changes.
    """

    position_every_s: sky.Number = sky.param("Least seconds between notes of a position.", default=5.0, gt=0, le=3600)
    known: Overheard

    def prepare(self, context: sky.AttackContext) -> None:
        self.known = Overheard(sky.from_seconds(self.position_every_s))

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        news, victim = self.known.learn(now, frame.payload), self.link.partition(":")[2]
        return [] if self.sham else [sky.Note(LEARNED, victim, data, (frame.id,)) for data in news]
