"""Taps of link attacks: what they act on, when, and the chance of each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, cast

from skyrange.attack.contract import AttackContext
from skyrange.attack.on_path import OnPath, PassiveTap, Selection, selection_of
from skyrange.codec.mavlink import dialect, message_id
from skyrange.codec.mavlink.frame_layout import CHECKSUM, HEADER_V2, LAYOUTS, MAGIC_V2, checksum
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.verdicts import Direction, Inject, Verdict
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.core.time import Time

MAX_INJECTS: Final = 64
"""Frames that a tap puts on its link at one time."""
_BLOCK_BITS: Final = 16
"""Bits of an address of chance that number the draws for one frame: a frame takes fewer than 2**16."""
_STREAM: Final = "attack.link"


@dataclass(frozen=True, slots=True)
class FrameChance:
    """Random numbers of an attack for each frame, addressed by attack, link, direction, sender and serial."""

    chance: Chance
    attack: str

    def draw(self, frame: Frame, block: int = 0) -> tuple[float, float, float, float]:
        """Four uniforms in [0, 1) for a frame; another `block` gives others."""
        who = hash64(f"{self.attack}|{frame.link}|{frame.direction}|{frame.sender}")
        return self.chance.uniform4(_STREAM, who, frame.sent_ns, frame.serial << _BLOCK_BITS | block)


@dataclass(frozen=True, slots=True)
class Rule:
    """What all taps of one attack share: the frames to act on, when, with what chance, and whether it is the sham."""

    selection: Selection
    schedule: Schedule
    chance: FrameChance
    sham: bool

    @property
    def start_ns(self) -> Time:
        """When the attack starts, as far as that is known."""
        return self.schedule.start_ns

    def acts(self, now: Time) -> bool:
        """Whether the attack acts at `now`."""
        return self.schedule.start_ns <= now < self.schedule.stop_ns


def rule_of(params: OnPath, context: AttackContext) -> Rule:
    """The rule of an attack with these parameters."""
    return Rule(selection_of(params), context.schedule, FrameChance(context.chance, context.id), context.sham)


@dataclass(slots=True)
class FrameTap(PassiveTap):
    """A tap that acts on the selected frames while its attack acts, and never on its own."""

    link: str
    rule: Rule

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Act on the frame if it is selected."""
        rule = self.rule
        if rule.acts(now) and rule.selection.takes(frame):
            return self.act(now, frame)
        return ()

    def act(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """The verdicts on a selected frame."""
        raise NotImplementedError


def inject_again(frame: Frame, payload: bytes) -> Inject:
    """A copy of a frame on its own link, with `payload`."""
    return Inject(payload, cast("Direction", frame.direction), frame.src, frame.dst, frame.id)


def benign_payload(payload: bytes) -> bytes:
    """Bytes of the same length that ask for nothing and report nothing: what a sham sends instead of `payload`.

    In place of a MAVLink frame that is an ENCAPSULATED_DATA with the same sender and sequence number, which no
    component of the range reads, as far as its payload of at most 255 bytes is long enough; else zeros.
    """
    size = len(payload) - HEADER_V2 - CHECKSUM
    if message_id(payload) is None or not 1 <= size <= 255:
        return bytes(len(payload))
    sender = payload[4:7] if payload[0] == MAGIC_V2 else payload[2:5]
    return mavlink_frame(dialect.MAVLINK_MSG_ID_ENCAPSULATED_DATA, sender, bytes(size - 1) + b"\1")


def mavlink_frame(number: int, sender: bytes, body: bytes) -> bytes:
    """A MAVLink 2 frame of a payload as it is; `sender` has sequence number, system id and component id."""
    header = bytes([MAGIC_V2, len(body), 0, 0]) + sender + number.to_bytes(3, "little")
    covered = header + body
    return covered + checksum(covered[1:], LAYOUTS[number].crc_extra).to_bytes(CHECKSUM, "little")
