"""Replay on a signed link: signed frames of the past, whose timestamps are not later than the last accepted one."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

import skyrange.plugin as sky
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.frame_layout import MAGIC_V2, SIGNATURE
from skyrange.codec.mavlink.signing import is_signed

_COMMANDS: Final = frozenset((
    mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT, mav.MAVLINK_MSG_ID_SET_MODE,
    mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
))  # fmt: skip


@sky.attack(
    "signing.replay",
    technique="T0855",
    persists="acts",
    effect="a signed link refuses and counts the replayed commands, because their timestamps are old",
    knowledge="none; it records what passes before the attack",
    position="on the network between ground station and aircraft",
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
    keep: Annotated[sky.Whole, Field(ge=1, le=1000)] = sky.param(
        "Number of commands that are kept, the first ones; they are replayed in turn.", default=16
    )
    kept: list[tuple[sky.FrameId, bytes]] = sky.state(list)
    turn: int = 0

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        payload = frame.payload
        command = frame.direction == "fwd" and sky.message_id(payload) in _COMMANDS
        signed = command and payload[0] == MAGIC_V2 and len(payload) > SIGNATURE and is_signed(payload)
        if signed and len(self.kept) < self.keep:
            self.kept.append((frame.id, payload))
        return ()

    def send(self, now: sky.Time) -> sky.Verdicts:
        if not self.kept:
            return ()
        parent, payload = self.kept[self.turn % len(self.kept)]
        self.turn += 1
        return [self.inject(payload[:-1] + bytes([payload[-1] ^ 0xFF]) if self.sham else payload, parent)]
