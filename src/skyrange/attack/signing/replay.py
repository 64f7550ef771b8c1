"""Replay on a signed link: signed frames of the past, whose timestamps are not later than the last accepted one."""

from __future__ import annotations

from typing import Final

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.compromised_sender import COMMANDS, read_timestamp
from skyrange.codec.mavlink import dialect as mav

_COMMANDS: Final = COMMANDS | {mav.MAVLINK_MSG_ID_SET_MODE, mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT}


@sky.attack(
    "signing.replay",
    technique="T0855",
    mechanism="link.replay",
    effect="a signed link refuses and counts the replayed commands, because their timestamps are old",
    knowledge="none; it records what passes before the attack",
    position="by place: near the link with a radio, in the operator's network, or on board",
    equipment="a computer that records and sends frames; no key",
    budget="a frame of about 57 bytes per replay",
    load="the sham: the same frames with a wrong signature, which are refused too",
    content="link.replay of unsigned commands on a link without signing",
    placement="the same replay on the link of another aircraft",
)
class SignedReplay(sky.InjectionOnLinks):
    """Sends signed commands of the past again on a signed link.

    The sham alters the last byte of the signature: its frames are refused too, as wrong instead of old.
    """

    every_s: sky.Number = sky.param("Time between two replayed frames, in seconds.", default=1.0, ge=0.1, le=3600)
    keep: sky.Whole = sky.param("Commands that are kept, the first ones, to replay in turn.", default=16, ge=1, le=1000)
    kept: list[tuple[sky.FrameId, bytes]] = sky.state(list)
    turn: int = 0

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        command = frame.direction == "fwd" and sky.message_id(frame.payload) in _COMMANDS
        if command and len(self.kept) < self.keep and read_timestamp(frame.payload) is not None:
            self.kept.append((frame.id, frame.payload))
        return ()

    def send(self, now: sky.Time) -> sky.Verdicts:
        if not self.kept:
            return ()
        parent, payload = self.kept[self.turn % len(self.kept)]
        self.turn += 1
        return [self.inject(payload[:-1] + bytes([payload[-1] ^ 0xFF]) if self.sham else payload, parent)]
