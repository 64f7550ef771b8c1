"""Signed MAVLink connections of an agent: received frames are verified and sent frames are signed.

Only connections that have a key are affected; frames on the agent's other ports pass unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from skyrange.codec.mavlink.frames import decode, message_name
from skyrange.codec.mavlink.message_columns import classify_frames
from skyrange.codec.mavlink.signing import SignatureRefusal, Signer, SigningKey
from skyrange.contracts.alerts import Scalar
from skyrange.contracts.frames import Payloads
from skyrange.contracts.mailboxes import Block, Columns, Departure, Inbox, Outbox
from skyrange.core.errors import DecodeError
from skyrange.core.ids import Port
from skyrange.core.time import Time
from skyrange.core.whole_numbers import worth_noting

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


class SignedConnections:
    """Signs and verifies the frames of all signed connections of one agent. Deep-copyable."""

    def __init__(self, ports: Sequence[Port], connections: Sequence[SignedConnection], link: int, note: str) -> None:
        """`ports` are the agent's; `link` is the link id in its signatures; `note` is the kind of the notes about
        refusals.
        """
        self._ports = tuple(ports)
        self._connections = list(connections)
        self._signers = [Signer(one.key, link) for one in connections]
        self._link = link
        self._note = note
        self._unsigned: set[int] = set()
        """Numbers of connections whose key was removed."""
        self._counts = np.zeros((len(self._signers), len(_REASONS)), dtype=np.int64)
        self._started = False
        self._index_ports()

    def _index_ports(self) -> None:
        signed = [(number, one) for number, one in enumerate(self._connections) if number not in self._unsigned]
        self._send_ports = {one.send_port: number for number, one in signed}
        receiving = {one.receive_port: number for number, one in signed}
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
        return next((number for number, one in enumerate(self._connections) if one.vehicle == vehicle), None)

    def start(self, now: Time, vehicle: str | None = None) -> None:
        """Start signing on all connections, or on those of one aircraft."""
        for one, signer in zip(self._connections, self._signers, strict=True):
            if vehicle is None or one.vehicle == vehicle:
                signer.start(now)

    def set_clock(self, now: Time, vehicle: str, unix_ns: int) -> None:
        """Advance the timestamps of one aircraft's connections to a clock that was set, never backwards."""
        self._begin(now)
        for one, signer in zip(self._connections, self._signers, strict=True):
            if one.vehicle == vehicle:
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
        mine = mail.payloads.take(rows)
        keep = np.ones(len(mail.payloads), dtype=np.bool_)
        numbers = self._receive_index[mail.places[rows]].tolist()
        for row, number, kind, frame in zip(rows.tolist(), numbers, classify_frames(mine).tolist(), mine, strict=True):
            found = self._signers[number].check(frame) if kind >= 0 else self._check_other(number, frame)
            if found is not None and not self._connections[number].exempt:
                keep[row] = False
                self._refuse(number, found, frame, inbox, mail.order.item(row), out)
        return mail if keep.all() else mail.take(np.flatnonzero(keep))

    def sign_outbox(self, now: Time, out: Outbox) -> None:
        """Sign all frames that are sent over signed connections, in the order in which they leave."""
        self._begin(now)
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
