"""Compromised MAVLink senders: frames added or altered in a station's own stream, and a companion that commands.

A receiver sees one sender: no gap or repetition of sequence numbers, one link id, and timestamps that increase.

ArduPilot accepts frames of its own system id always, also with the option that enforces the id of the ground station
(GCS_Common.cpp, `GCS_MAVLINK::accept_packet`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, ClassVar, Final, Literal

from skyrange.attack.bases.links import CopyForLink, RoundsOnLink
from skyrange.attack.bases.mavlink.message_fields import read_fields, write_fields
from skyrange.attack.bases.mavlink.orders import NOBODY, STATION, Order, Sender
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Facts
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.params import Victims, check_vehicles
from skyrange.codec.mavlink import Message, Packer, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.frames import CHECKSUM, HEADER_V2, LAYOUTS, MAGIC_V2, SIGNATURE, SIGNED, checksum
from skyrange.codec.mavlink.signing import is_signed, range_passphrase, secret_from_passphrase, sign_frame
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.plugins.form import param
from skyrange.contracts.verdicts import Inject, Replace, Verdicts
from skyrange.core.geodesy import Origin
from skyrange.core.ids import link_name, operator_of
from skyrange.core.time import Time

_SEQUENCE: Final = 4
"""Offset of the sequence number in a MAVLink 2 frame."""
_DIGEST: Final = 6
COMMANDS: Final = frozenset((int(mav.MAVLINK_MSG_ID_COMMAND_LONG), int(mav.MAVLINK_MSG_ID_COMMAND_INT)))
_TARGETS: Final = frozenset((
    mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT, mav.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mav.MAVLINK_MSG_ID_SET_MODE,
))  # fmt: skip
_ORDERS: Final = frozenset((
    mav.MAV_CMD_DO_SET_MODE, mav.MAV_CMD_NAV_RETURN_TO_LAUNCH, mav.MAV_CMD_NAV_LAND, mav.MAV_CMD_MISSION_START,
    mav.MAV_CMD_DO_REPOSITION, mav.MAV_CMD_NAV_LOITER_UNLIM, mav.MAV_CMD_DO_PAUSE_CONTINUE,
    mav.MAV_CMD_DO_CHANGE_SPEED,
))  # fmt: skip
"""Commands that change where an aircraft in flight goes."""


def without_signature(frame: bytes) -> bytes | None:
    """A whole MAVLink 2 frame of the dialect as it was before it was signed; `None` for anything else."""
    if len(frame) < HEADER_V2 + CHECKSUM or frame[0] != MAGIC_V2 or frame[2] & ~SIGNED:
        return None
    end = HEADER_V2 + frame[1]
    if len(frame) != end + CHECKSUM + (SIGNATURE if frame[2] else 0) or _number(frame) not in LAYOUTS:
        return None
    return with_sequence(frame, frame[_SEQUENCE])


def with_sequence(frame: bytes, sequence: int) -> bytes:
    """The unsigned frame with another sequence number (0 to 255)."""
    covered = frame[:2] + b"\0" + frame[3:_SEQUENCE] + bytes([sequence]) + frame[_SEQUENCE + 1 : HEADER_V2 + frame[1]]
    return covered + checksum(covered[1:], LAYOUTS[_number(frame)].crc_extra).to_bytes(CHECKSUM, "little")


def _number(frame: bytes) -> int:
    return frame[7] | frame[8] << 8 | frame[9] << 16


@dataclass(slots=True)
class SenderStream:
    """The frames of one sender on one link in one direction."""

    secret: bytes
    """Signing key of the sender; used only where its frames are signed with it."""
    added: int = 0
    """Frames that were added."""
    sequence: int = -1
    """Sequence number of the last frame that left."""
    stamp: int = 0
    """Timestamp of the last signed frame that left, in 10 µs since 2015."""
    link_id: int = 0
    signs: bool = False
    """Whether the sender signs with this key."""

    def forward(self, frame: bytes, content: bytes | None = None) -> bytes:
        """A frame of the sender as it leaves, with `content` (an unsigned frame) in its place.

        What is no frame of the dialect, or is signed with another key, is returned as it is.
        """
        plain = without_signature(frame)
        if plain is None or (is_signed(frame) and not self._has_key(frame)):
            return frame
        self.sequence = (frame[_SEQUENCE] + self.added) & 0xFF
        self.signs = is_signed(frame)
        if content is None and not self.added:
            if self.signs:
                self.link_id, self.stamp = frame[-SIGNATURE], max(self.stamp, _stamp_of(frame))
            return frame
        leaves = with_sequence(plain if content is None else content, self.sequence)
        if not self.signs:
            return leaves
        self.link_id = frame[-SIGNATURE]
        stamp = max(_stamp_of(frame), self.stamp + 1) if self.added else _stamp_of(frame)
        self.stamp = max(self.stamp, stamp)
        return sign_frame(leaves, self.secret, self.link_id, stamp)

    def add(self, frame: bytes) -> bytes:
        """An unsigned frame of the attacker as the next frame of the sender."""
        self.added += 1
        self.sequence = (self.sequence + 1) & 0xFF
        leaves = with_sequence(frame, self.sequence)
        if not self.signs:
            return leaves
        self.stamp += 1
        return sign_frame(leaves, self.secret, self.link_id, self.stamp)

    def observe(self, frame: bytes) -> None:
        """Learn from a frame of another sender on the link whether it is signed with the key, and how late it is."""
        if without_signature(frame) is not None and is_signed(frame) and self._has_key(frame):
            self.signs, self.stamp = True, max(self.stamp, _stamp_of(frame))

    def _has_key(self, frame: bytes) -> bool:
        return sha256(self.secret + frame[:-_DIGEST]).digest()[:_DIGEST] == frame[-_DIGEST:]


def read_timestamp(frame: bytes) -> int | None:
    """The timestamp in the signature of a frame, which is not encrypted; `None` for a frame without a signature."""
    return _stamp_of(frame) if len(frame) >= SIGNATURE and is_signed(frame) else None


def station_key(seed: int, operator: str) -> bytes:
    """The key that an operator's ground station and aircraft sign with."""
    return secret_from_passphrase(range_passphrase(seed, operator))


def _stamp_of(frame: bytes) -> int:
    return int.from_bytes(frame[-SIGNATURE + 1 : -_DIGEST], "little")


def command_of(frame: bytes) -> int | None:
    """The MAV_CMD in a COMMAND_LONG or COMMAND_INT, signed or not; `None` for anything else."""
    number = message_id(frame)
    plain = without_signature(frame) if number is not None and number in COMMANDS else None
    fields = None if plain is None or number is None else read_fields(plain, number)
    return None if fields is None else int(fields["command"])


def acknowledge(command: int, *, sham: bool) -> Message:
    """The acknowledgement of a command for the station; that of a sham addresses nobody."""
    station = NOBODY if sham else STATION[0]
    return mav.MAVLink_command_ack_message(
        command, mav.MAV_RESULT_ACCEPTED, target_system=station, target_component=STATION[1]
    )


def redirect_order(frame: bytes, *, sham: bool) -> bytes | None:
    """An order to an aircraft in flight, addressed to nobody and not signed; the sham leaves its address.

    `None` for a frame that is no such order.
    """
    number = message_id(frame)
    if number is None or number not in COMMANDS | _TARGETS:
        return None
    if number in COMMANDS and command_of(frame) not in _ORDERS:
        return None
    plain = without_signature(frame)
    fields = None if plain is None else read_fields(plain, number)
    if plain is None or fields is None:
        return None
    if not sham:
        fields["target_system"] = NOBODY
    return write_fields(plain, number, fields, plain[1])


COMPONENT: Final = int(mav.MAV_COMP_ID_ONBOARD_COMPUTER)


class CompromisedCompanion(RoundsOnLink):
    """Runs in the companion of each aircraft, on the link to the proxy: what that forwards and what it sends.

    It holds back the orders that `holds_back` says, and adds those of `orders` to the companion's own stream, every
    `every_s` if the kind sets that.
    """

    attack_facts: ClassVar[Facts] = {
        "surface": ("log",),
        "persists": "acts",
        "intrudes": True,
        "position": "in the companion computer",
        "equipment": "a program on the companion: from its supply chain, an update or a remote login",
        "load": "the sham: as many frames of the same lengths to the aircraft, which change nothing",
        "placement": "the companion of another aircraft",
    }

    holds_back: ClassVar[Literal["station", "companion", ""]] = ""
    """Whose orders are redirected to nobody while it acts."""

    vehicles: Victims = param("Aircraft whose companion is compromised, such as ['blue/b1'].")

    origin: Origin
    systems: dict[str, int]
    """MAVLink system ids of the aircraft."""
    system: int
    """That of the aircraft on the link."""
    sender: Sender
    """The companion; that of a sham sends harmless frames."""
    own: SenderStream
    forwarded: SenderStream

    def assemble(self, context: AttackContext) -> Any:
        """See `Acting`. Raises `InputError` for aircraft that are not in the scenario."""
        check_vehicles(context, self.vehicles)
        self.origin = context.origin
        self.systems = {vehicle: context.vehicles[vehicle].system_id for vehicle in self.vehicles}
        return super().assemble(context)

    def build(self, context: AttackContext) -> Attack:
        """A tap in each companion."""
        make = CopyForLink(self)
        return Attack(
            taps=[TapPlacement(link_name("log", vehicle), "companion", make) for vehicle in self.vehicles],
            shown=self.marks(),
            exclusive=[Exclusive(f"companion of {vehicle}") for vehicle in self.vehicles],
        )

    def begin(self) -> None:
        """Take the name and the key of the companion."""
        super().begin()
        vehicle = self.link.partition(":")[2]
        self.system = self.systems[vehicle]
        self.sender = Sender(Packer(self.system, COMPONENT), self.system, claims_station=False, is_sham=self.sham)
        secret = station_key(self.chance.seed, operator_of(vehicle))
        self.own, self.forwarded = SenderStream(secret), SenderStream(secret)

    def see(self, now: Time, frame: Frame) -> None:
        """Learn from a frame of either direction."""

    def on_frame(self, now: Time, frame: Frame) -> Verdicts:
        """Learn from it, and hold it back if it is an order."""
        self.see(now, frame)
        payload = frame.payload
        if frame.direction != "fwd" or message_id(payload) is None:
            return ()
        is_own = payload[5:7] == bytes((self.system, COMPONENT))
        if not is_own:
            self.own.observe(payload)
        stream = self.own if is_own else self.forwarded
        content = None
        if self.holds_back == ("companion" if is_own else "station") and self.is_acting(now):
            content = redirect_order(payload, sham=self.sham)
        sent = stream.forward(payload, content)
        return [Replace(sent)] if content is not None or sent != payload else ()

    def send(self, now: Time) -> Verdicts:
        """The orders of a round, as frames."""
        return self.command(self.orders(now))

    def orders(self, now: Time) -> Sequence[Order | Message]:
        """The commands and other messages of a round."""
        return ()

    def command(self, orders: Sequence[Order | Message]) -> list[Inject]:
        """Orders as the next frames of the companion."""
        return [self.inject(self.own.add(self.sender.pack(order))) for order in orders]
