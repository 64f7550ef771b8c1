"""Replay on a signed link: signed frames of the past, whose timestamps are not later than the last accepted one."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from skyrange.attack.bases.mavlink.injection import InjectionOnLinks
from skyrange.attack.contract import Controls, ThreatModel
from skyrange.attack.declaration import attack
from skyrange.attack.presets import CONTROL_LINKS
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.codec.mavlink.frame_layout import MAGIC_V2, SIGNATURE
from skyrange.codec.mavlink.signing import is_signed
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number, Whole
from skyrange.contracts.plugins.fields import param, state
from skyrange.contracts.verdicts import Verdicts
from skyrange.core.ids import FrameId
from skyrange.core.time import Time

_COMMANDS: Final = frozenset((
    mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT, mav.MAVLINK_MSG_ID_SET_MODE,
    mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
))  # fmt: skip


@attack(
    "signing.replay",
    technique="T0855",
    surface=CONTROL_LINKS,
    persists="acts",
    effect="a signed link refuses and counts the replayed commands, because their timestamps are old",
    threat=ThreatModel(
        knowledge="none; it records what passes before the attack",
        position="on the network between ground station and aircraft",
        equipment="a computer that records and sends frames; no key",
        budget="a frame of about 57 bytes per replay",
    ),
    controls=Controls(
        load="the sham: the same frames with a wrong signature, which are refused too",
        content="link.replay of unsigned commands on a link without signing",
        placement="the same replay on the link of another aircraft",
    ),
)
class SignedReplay(InjectionOnLinks):
    """Sends signed commands of the past again on a signed link.

    The sham alters the last byte of the signature: its frames are refused too, as wrong instead of old.
    """

    every_s: Number = param("Time between two replayed frames, in seconds.", default=1.0, ge=0.1, le=3600)
    keep: Annotated[Whole, Field(ge=1, le=1000)] = param(
        "Number of commands that are kept, the first ones; they are replayed in turn.", default=16
    )
    kept: list[tuple[FrameId, bytes]] = state(list)
    turn: int = 0

    def on_frame(self, now: Time, frame: Frame) -> Verdicts:
        """Record a signed command."""
        payload = frame.payload
        command = frame.direction == "fwd" and message_id(payload) in _COMMANDS
        signed = command and payload[0] == MAGIC_V2 and len(payload) > SIGNATURE and is_signed(payload)
        if signed and len(self.kept) < self.keep:
            self.kept.append((frame.id, payload))
        return ()

    def send(self, now: Time) -> Verdicts:
        """Replay the next frame."""
        if not self.kept:
            return ()
        parent, payload = self.kept[self.turn % len(self.kept)]
        self.turn += 1
        return [self.inject(payload[:-1] + bytes([payload[-1] ^ 0xFF]) if self.sham else payload, parent)]
