"""Hostile MAVLink: frames that are truncated, damaged or unknown, or valid ones with absurd counts and numbers."""

from __future__ import annotations

from typing import Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.hostile_frames import FORMS, Draw, Forms, draw_frame, harmless_frame


@sky.attack(
    "mavlink.malformed",
    technique="T0814",
    persists="flight",
    effect="parsers reject and count hostile frames, or act on absurd values",
    knowledge="the protocol, and system ids",
    equipment="a computer with a fuzzer for MAVLink",
    budget="rate_hz frames of at most 267 bytes in a second",
    load="the sham: valid frames of the same sizes that nobody acts on",
    content="the form 'unknown' alone, which every receiver ignores",
    placement="the same frames on the link of another aircraft",
)
class HostileFrames(sky.Injection):
    """Sends malformed MAVLink frames, and valid ones with absurd counts and numbers.

    ArduPilot's simulator aborts on a floating point exception, which boards ignore, unless SIM_FLOAT_EXCEPT is 0; so
    the form `numbers` can end that program.
    """

    forms: Forms = sky.param(
        "Forms, one chosen by chance for each frame: garbage (random bytes), truncated, checksum (wrong, as by another "
        "CRC_EXTRA), length (other than the header's), unknown (message id), mavlink1 (a header of version 1 before a "
        "frame of version 2), counts (65535 items and the like), numbers (NaN, infinite or 3e38).",
        default=FORMS,
    )
    towards: Literal["aircraft", "station"] = sky.param("Receiver; station: as from the aircraft.", default="aircraft")
    rate_hz: sky.Number = sky.param("Frames in a second.", default=10.0, ge=0.1, le=1000)

    def prepare(self, context: sky.AttackContext) -> None:
        self.way = "fwd" if self.towards == "aircraft" else "rev"
        self.every_s = 1.0 / self.rate_hz

    def orders(self, now: sky.Time) -> list[bytes]:
        draw = Draw.of(self.chance.uniform4(f"{self.id}.malformed", sky.hash64(self.link), now))
        to_station = self.way == "rev"
        packer = sky.MavlinkPacker(self.target, sky.AUTOPILOT) if to_station else self.claimed.packer
        payload = draw_frame(self.forms, draw, packer, self.target, to_station)
        return [harmless_frame(len(payload), packer) if self.sham else payload]
