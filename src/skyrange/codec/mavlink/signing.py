"""MAVLink 2 message signing: signatures, the rules for accepting them, and signed connections of an agent.

Sources: https://mavlink.io/en/guide/message_signing.html ("Frame Format", "Timestamp Handling", "Accepting Signed
Packets", "Accepting Unsigned Packets"); MAVLink's C library, mavlink_helpers.h (`mavlink_sign_packet`,
`mavlink_signature_check`), and ArduPilot's GCS_Signing.cpp (`accept_unsigned_callback`), which these rules follow.

This is a model of the defence: its keys protect a simulated link and are not secrets.

Received frames are verified and sent frames are signed on those connections of an agent that have a key; frames on its
other ports pass unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from hashlib import sha256
from typing import Final, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyrange.codec.mavlink.frames import (
    CHECKSUM,
    HEADER_V2,
    LAYOUTS,
    MAGIC_V2,
    SIGNATURE,
    SIGNED,
    checksum,
    decode,
    message_id,
    message_name,
)
from skyrange.codec.mavlink.message_columns import classify_frames
from skyrange.contracts.alerts import Scalar
from skyrange.contracts.frames import Payloads
from skyrange.contracts.mailboxes import Block, Columns, Departure, Inbox, Outbox
from skyrange.core.errors import DecodeError
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_S, NS_PER_US, Time
from skyrange.core.whole_numbers import worth_noting

KEY_BYTES: Final = 32
ZERO_UNIX_NS: Final = 1_420_070_400 * NS_PER_S
"""Timestamps count from 2015-01-01T00:00:00Z ("Timestamp Handling")."""
UNIT_NS: Final[Time] = 10 * NS_PER_US
LAST_TIMESTAMP: Final = 2**48 - 1
"""The largest 48-bit timestamp, reached in 2104."""
MAX_LAG: Final = 6_000_000
"""How far a new stream may lag behind the own timestamp: a minute ("Timestamp Handling", last rule)."""
MAX_STREAMS: Final = 16
"""MAVLINK_MAX_SIGNING_STREAMS: further streams are refused, which bounds memory."""
ACCEPTED_UNSIGNED: Final = frozenset((int(dialect.MAVLINK_MSG_ID_RADIO_STATUS), int(dialect.MAVLINK_MSG_ID_RADIO)))
"""Messages accepted without a signature: telemetry radios hold no key (GCS_Signing.cpp `accept_list`)."""
_DIGEST: Final = 6
_STAMP: Final = 6


class SignatureRefusal(StrEnum):
    """Why a frame is refused."""

    UNSIGNED = "not signed"
    WRONG = "wrong signature"
    REPLAYED = "timestamp not after the last"
    OLD = "timestamp more than a minute behind"
    TOO_MANY_STREAMS = "too many streams"


class ClockRule(StrEnum):
    """Which settings of an aircraft's clock advance the timestamp of its signatures."""

    EVERY_FIX = "every-fix"
    """Each one, as ArduPilot (GCS_Signing.cpp `update_signing_timestamp`)."""
    FIRST_FIX = "first-fix"
    """The first one alone, as issue 13860 of ArduPilot proposes."""
    BOUNDED = "bounded"
    """Those that advance it by at most `MAX_LAG`."""
    NEVER = "never"
    """None: the timestamp is that which was stored, and what accepted frames and sending make of it."""


class SigningTime(NamedTuple):
    """By what the timestamp of one end of a signed connection advances."""

    rule: ClockRule = ClockRule.EVERY_FIX
    follows: bool = True
    """Whether it advances to those of accepted frames ("Timestamp Handling"). If not, each frame has the time of the
    clock, as those of Mission Planner (MavlinkParse.cs `GenerateMAVLinkPacket20`)."""


SIGNING_TIME: Final = SigningTime()
"""As ArduPilot and MAVLink's C library."""


class SigningKey(NamedTuple):
    """A key as SETUP_SIGNING carries it: that of the pairing before the flight, or one that came later."""

    secret: bytes
    """`KEY_BYTES` bytes."""
    initial: int
    """The timestamp of the component's clock at time 0 of the run."""


def secret_from_passphrase(passphrase: str) -> bytes:
    """The 32 bytes that ground stations derive from a passphrase: its SHA-256 ("Secret Key Management")."""
    return sha256(passphrase.encode()).digest()


def range_passphrase(seed: int, operator: str) -> str:
    """What an operator's ground station and aircraft are paired with, as one would type it into a ground station."""
    return f"skyrange/{seed}/{operator}"


def signing_timestamp(unix_ns: int) -> int:
    """The timestamp of a moment in UTC, in 10 µs since 2015, clipped to 48 bits."""
    return min(max(unix_ns - ZERO_UNIX_NS, 0) // UNIT_NS, LAST_TIMESTAMP)


def is_signed(frame: bytes) -> bool:
    """Whether a whole frame carries a signature, valid or not."""
    return frame[0] == MAGIC_V2 and bool(frame[2] & SIGNED)


def sign_frame(frame: bytes, secret: bytes, link: int, timestamp: int) -> bytes:
    """The signed form of an unsigned MAVLink 2 frame of the dialect: flag set, checksum recomputed,
    13 bytes appended.
    """
    end = HEADER_V2 + frame[1]
    number = frame[7] | frame[8] << 8 | frame[9] << 16
    covered = b"%c%c%c%b" % (frame[0], frame[1], SIGNED, frame[3:end])
    crc = checksum(covered[1:], LAYOUTS[number].crc_extra)
    covered += crc.to_bytes(CHECKSUM, "little") + (timestamp << 8 | link).to_bytes(1 + _STAMP, "little")
    return covered + sha256(secret + covered).digest()[:_DIGEST]


class Signer:
    """One end of a signed connection: signs what it sends and verifies what it receives. Deep-copyable.

    As in the C library the timestamp is one number. Each frame sent increments it; each frame accepted raises it to
    that frame's timestamp; the clock advances it only at `start` and when it is set.
    """

    __slots__ = ("clock_was_set", "key", "link", "streams", "time", "timestamp")

    def __init__(self, key: SigningKey, link: int, time: SigningTime = SIGNING_TIME) -> None:
        """`link` 0…255 distinguishes the connections of one component; raises `ValueError` for a key of the wrong
        length.
        """
        if len(key.secret) != KEY_BYTES:
            raise ValueError(f"a key of {len(key.secret)} bytes, MAVLink's have {KEY_BYTES}")
        self.key = key
        self.link = link
        self.time = time
        self.timestamp = 0
        self.clock_was_set = False
        self.streams: dict[tuple[int, int, int], int] = {}
        """(system, component, link) → the last timestamp accepted."""

    def start(self, now: Time) -> None:
        """Start, or restart after a reboot: streams are forgotten, and the timestamp is the clock's or the stored one.

        A minute is added to the stored timestamp, so that no frame from before the restart is accepted as one of a new
        stream (GCS_Signing.cpp `load_signing_key`).
        """
        self.streams.clear()
        stored = (self.timestamp + MAX_LAG) % 2**64 if self.timestamp else 0
        self.timestamp = max(stored, min(self.key.initial + max(now, 0) // UNIT_NS, LAST_TIMESTAMP))

    def set_key(self, key: SigningKey, timestamp: int) -> None:
        """Sign and verify with another key, which came with a timestamp of 64 bits that nobody checks.

        The own timestamp is a minute after it, and the streams stay: keys change, and `signing_streams` does not
        (GCS_Signing.cpp `handle_setup_signing` and `load_signing_key`). One that is far in the future refuses all new
        streams for good.
        """
        self.key, self.timestamp = key, (timestamp + MAX_LAG) % 2**64

    def set_clock(self, unix_ns: int) -> None:
        """Advance the timestamp to a clock that was set, in whole seconds and never backwards.

        GCS_Signing.cpp `update_signing_timestamp`. The rule of the connection may ignore it.
        """
        timestamp, first = signing_timestamp(unix_ns // NS_PER_S * NS_PER_S), not self.clock_was_set
        self.clock_was_set = True
        match self.time.rule:
            case ClockRule.NEVER:
                return
            case ClockRule.FIRST_FIX if not first:
                return
            case ClockRule.BOUNDED if timestamp > self.timestamp + MAX_LAG:
                return
        self.timestamp = max(self.timestamp, timestamp)

    def read_clock(self, now: Time) -> None:
        """Advance the timestamp to the component's own clock, before it signs without following others."""
        self.timestamp = max(self.timestamp, min(self.key.initial + max(now, 0) // UNIT_NS, LAST_TIMESTAMP))

    def sign(self, frame: bytes) -> bytes:
        """The signed form of a frame to send."""
        timestamp = self.timestamp & LAST_TIMESTAMP
        self.timestamp += 1
        return sign_frame(frame, self.key.secret, self.link, timestamp)

    def check(self, frame: bytes) -> SignatureRefusal | None:
        """Why a whole frame with a correct checksum is refused, or `None`; remembers the timestamp of an accepted
        frame.

        MAVLink 1 cannot be signed.
        """
        refusal = self._verify(frame) if is_signed(frame) else SignatureRefusal.UNSIGNED
        return None if refusal is not None and message_id(frame) in ACCEPTED_UNSIGNED else refusal

    def _verify(self, frame: bytes) -> SignatureRefusal | None:
        if sha256(self.key.secret + frame[:-_DIGEST]).digest()[:_DIGEST] != frame[-_DIGEST:]:
            return SignatureRefusal.WRONG
        stream = (frame[5], frame[6], frame[-SIGNATURE])
        timestamp = int.from_bytes(frame[-_DIGEST - _STAMP : -_DIGEST], "little")
        last = self.streams.get(stream)
        if last is None:
            if len(self.streams) >= MAX_STREAMS:
                return SignatureRefusal.TOO_MANY_STREAMS
            if timestamp + MAX_LAG < self.timestamp:
                return SignatureRefusal.OLD
        elif timestamp <= last:
            return SignatureRefusal.REPLAYED
        self.streams[stream] = timestamp
        if self.time.follows:
            self.timestamp = max(self.timestamp, timestamp)
        return None


_REASONS: Final = tuple(SignatureRefusal)


class SignedConnection(NamedTuple):
    """A signed connection: its aircraft, its key, and the ports on which the agent receives and sends."""

    vehicle: str
    """The aircraft that notes name."""
    key: SigningKey
    receive_port: Port
    send_port: Port
    exempt: bool = False
    """Whether frames that fail verification are accepted, as ArduPilot does on its first channel (GCS_Signing.cpp
    `accept_unsigned_callback`). Its own frames are signed all the same."""
    time: SigningTime = SIGNING_TIME


class SignedConnections:
    """Signs and verifies the frames of all signed connections of one agent. Deep-copyable."""

    def __init__(self, ports: Sequence[Port], connections: Sequence[SignedConnection], link: int, note: str) -> None:
        """`ports` are the agent's; `link` is the link id in its signatures; `note` is the kind of the notes about
        refusals.
        """
        self._ports = tuple(ports)
        self._connections = list(connections)
        self._signers = [Signer(connection.key, link, connection.time) for connection in connections]
        self._clocked = [signer for signer in self._signers if not signer.time.follows]
        self._link = link
        self._note = note
        self._unsigned: set[int] = set()
        """Numbers of connections whose key was removed."""
        self._counts = np.zeros((len(self._signers), len(_REASONS)), dtype=np.int64)
        self._started = False
        self._index_ports()

    def _index_ports(self) -> None:
        signed = [
            (number, connection) for number, connection in enumerate(self._connections) if number not in self._unsigned
        ]
        self._send_ports = {connection.send_port: number for number, connection in signed}
        receiving = {connection.receive_port: number for number, connection in signed}
        self._receive_index = np.array([receiving.get(port, -1) for port in self._ports], dtype=np.int64)
        self._send_index = np.array([self._send_ports.get(port, -1) for port in self._ports], dtype=np.int64)

    def set_key(self, now: Time, connection: SignedConnection, timestamp: int) -> None:
        """Give a connection, which may be new, the key that it names, as SETUP_SIGNING does (`Signer.set_key`)."""
        self._begin(now)
        number = self._find(connection.vehicle)
        if number is None:
            number = len(self._connections)
            self._connections.append(connection)
            self._signers.append(Signer(connection.key, self._link))
            self._counts = np.concatenate([self._counts, np.zeros((1, len(_REASONS)), dtype=np.int64)])
        self._signers[number].set_key(connection.key, timestamp)
        self._unsigned.discard(number)
        self._index_ports()

    def remove_key(self, vehicle: str) -> None:
        """Let an aircraft's connection neither sign nor verify from now on; one that is not signed stays as it is."""
        number = self._find(vehicle)
        if number is not None:
            self._unsigned.add(number)
            self._index_ports()

    def _find(self, vehicle: str) -> int | None:
        return next(
            (number for number, connection in enumerate(self._connections) if connection.vehicle == vehicle), None
        )

    def start(self, now: Time, vehicle: str | None = None) -> None:
        """Start signing on all connections, or on those of one aircraft."""
        for connection, signer in zip(self._connections, self._signers, strict=True):
            if vehicle is None or connection.vehicle == vehicle:
                signer.start(now)

    def set_clock(self, now: Time, vehicle: str, unix_ns: int) -> None:
        """Advance the timestamps of one aircraft's connections to a clock that was set, never backwards."""
        self._begin(now)
        for connection, signer in zip(self._connections, self._signers, strict=True):
            if connection.vehicle == vehicle:
                signer.set_clock(unix_ns)

    @property
    def refused(self) -> int:
        """Number of frames that failed verification."""
        return int(self._counts.sum())

    def verify_inbox(self, now: Time, inbox: Inbox, mail: Columns, out: Outbox) -> Columns:
        """Return the received frames without those that fail verification.

        Refused frames are counted, and the 1st, 2nd, 4th, 8th … of each reason are noted. A payload that is not a
        whole frame is left for the reader to count: the checksum is checked before the signature.
        """
        self._begin(now)
        rows = np.flatnonzero(self._receive_index[mail.places] >= 0)
        payloads = mail.payloads.take(rows)
        keep = np.ones(len(mail.payloads), dtype=np.bool_)
        numbers = self._receive_index[mail.places[rows]].tolist()
        for row, number, kind, frame in zip(
            rows.tolist(), numbers, classify_frames(payloads).tolist(), payloads, strict=True
        ):
            refusal = self._signers[number].check(frame) if kind >= 0 else self._check_other(number, frame)
            if refusal is not None and not self._connections[number].exempt:
                keep[row] = False
                self._refuse(number, refusal, frame, inbox, mail.order.item(row), out)
        return mail if keep.all() else mail.take(np.flatnonzero(keep))

    def sign_outbox(self, now: Time, out: Outbox) -> None:
        """Sign all frames that are sent over signed connections, in the order in which they leave."""
        self._begin(now)
        for signer in self._clocked:
            signer.read_clock(now)
        for place, departure in enumerate(out.departures):
            number = self._send_ports.get(departure.port)
            if number is not None:
                frame = self._signers[number].sign(departure.payload)
                out.departures[place] = Departure(departure.port, frame, departure.causes)
        for place, block in enumerate(out.blocks):
            numbers = self._send_index[block.places]
            if (numbers < 0).all():
                continue
            frames = [
                self._signers[number].sign(frame) if number >= 0 else frame
                for number, frame in zip(numbers.tolist(), block.payloads, strict=True)
            ]
            out.blocks[place] = Block(block.places, Payloads.of(frames), block.parents)

    def _begin(self, now: Time) -> None:
        if not self._started:
            self._started = True
            self.start(now)

    def _check_other(self, number: int, frame: bytes) -> SignatureRefusal | None:
        """Verify a payload that batch decoding rejected: MAVLink 1, which is never signed, or not a frame at all."""
        try:
            decode(frame)
        except DecodeError:
            return None
        return self._signers[number].check(frame)

    def _refuse(self, number: int, why: SignatureRefusal, frame: bytes, inbox: Inbox, order: int, out: Outbox) -> None:
        column = _REASONS.index(why)
        self._counts[number, column] += 1
        count = self._counts.item(number, column)
        if worth_noting(count):
            data: dict[str, Scalar] = {"count": count, "reason": str(why), "message": message_name(frame)}
            out.note(self._note, self._connections[number].vehicle, data, (inbox.arrival(order).ref,))
