"""Replay on a signed link: signed frames of the past, whose timestamps are not later than the last accepted one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Final

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.on_path import Names, Repetition, ends_of, side_of
from skyrange.attack.signing.stolen_key import ROLES
from skyrange.attack.telemetry.alteration import telemetry_links
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.codec.mavlink.frame_layout import MAGIC_V2, SIGNATURE
from skyrange.codec.mavlink.signing import is_signed
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import Number, Params, Whole
from skyrange.contracts.verdicts import Inject, Verdict
from skyrange.core.ids import FrameId
from skyrange.core.time import Time, from_seconds

_COMMANDS: Final = frozenset(
    (
        int(mav.MAVLINK_MSG_ID_COMMAND_LONG),
        int(mav.MAVLINK_MSG_ID_COMMAND_INT),
        int(mav.MAVLINK_MSG_ID_SET_MODE),
        int(mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT),
    )
)
_SHAM_BYTE: Final = -1
"""The sham alters the last byte of the signature: its frames are refused too, as wrong instead of old."""


class SignedReplay(Params):
    """Signed commands are recorded and sent again."""

    links: Annotated[Names, Field(min_length=1)] = Field(
        description="Links gcs, log or autopilot by name or pattern, such as ['gcs:blue/b1']."
    )
    every_s: Number = Field(default=1.0, ge=0.1, le=3600, description="Time between two replayed frames, in seconds.")
    keep: Annotated[Whole, Field(ge=1, le=1000)] = Field(
        default=16, description="Number of commands that are kept, the first ones; they are replayed in turn."
    )


@dataclass(slots=True)
class SignedReplayer:
    """A tap that records signed commands towards the aircraft and replays them as they were."""

    link: str
    keep: int
    sham: bool
    repetition: Repetition
    kept: list[tuple[FrameId, bytes]] = field(default_factory=list)
    turn: int = 0

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Record a signed command."""
        payload = frame.payload
        command = frame.direction == "fwd" and message_id(payload) in _COMMANDS
        signed = command and payload[0] == MAGIC_V2 and len(payload) > SIGNATURE and is_signed(payload)
        if signed and len(self.kept) < self.keep:
            self.kept.append((frame.id, payload))
        return ()

    def next_wakeup(self) -> Time | None:
        """When the next frame is due."""
        return self.repetition.due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Replay the next frame."""
        if not self.repetition.take(now) or not self.kept:
            return ()
        parent, payload = self.kept[self.turn % len(self.kept)]
        self.turn += 1
        if self.sham:
            payload = payload[:_SHAM_BYTE] + bytes([payload[_SHAM_BYTE] ^ 0xFF])
        return [Inject(payload, "fwd", *ends_of(self.link, "fwd"), parent)]


@dataclass(frozen=True, slots=True)
class _MakeTap:
    params: SignedReplay
    context: AttackContext

    def __call__(self, link: str) -> SignedReplayer:
        repetition = Repetition(self.context.schedule, from_seconds(self.params.every_s))
        return SignedReplayer(link, self.params.keep, self.context.sham, repetition)


def make(params: SignedReplay, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or of another kind."""
    links = telemetry_links(params.links, context, ROLES)
    maker = _MakeTap(params, context)
    return Attack(taps=[TapPlacement(name, side_of(name), maker) for name in links])


REPLAY = AttackPlugin(
    SignedReplay,
    make,
    "Sends signed commands of the past again on a signed link.",
    technique="T0855",
    surface=ROLES,
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
