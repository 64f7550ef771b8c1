"""Gossip of a hashgraph on `uss` links: one JSON object per frame, HTTP-like, as on the `approval` link.

A member asks another for what it does not know (GET, with hashes of what it knows), and then tells it what that does
not know (POST). Hashes, signatures and transactions are written in base 16 and 64.
"""

from __future__ import annotations

import base64
import binascii
import json
from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skyrange.codec.json_errors import describe
from skyrange.core.errors import DecodeError
from skyrange.core.time import Time
from skyrange.utm.hashgraph.events import HASH_BYTES, NO_PARENT, Event

PATH: Final = "/hashgraph/v1/events"
MAX_FRAME_BYTES = 4_194_304
MAX_EVENTS = 4_096
MAX_TRANSACTIONS = 64
MAX_KNOWN = 1_024
_Hash = Annotated[str, Field(pattern=rf"^([0-9a-f]{{{2 * HASH_BYTES}}})?$")]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class EventMessage(_Model):
    """One event; parents are empty in a member's first."""

    creator: Annotated[str, Field(max_length=64)]
    self_parent: _Hash
    other_parent: _Hash
    time_ns: Annotated[int, Field(ge=-(2**62), le=2**62)]
    transactions: Annotated[tuple[Annotated[str, Field(max_length=2_000_000)], ...], Field(max_length=MAX_TRANSACTIONS)]
    signature: Annotated[str, Field(max_length=256)]

    @classmethod
    def of(cls, event: Event) -> EventMessage:
        """The message of an event."""
        return cls(
            creator=event.creator,
            self_parent=event.self_parent.hex(),
            other_parent=event.other_parent.hex(),
            time_ns=event.time,
            transactions=tuple(base64.b64encode(transaction).decode() for transaction in event.transactions),
            signature=event.signature.hex(),
        )

    def event(self) -> Event:
        """The event. Raises `DecodeError` where it is not written as it has to be."""
        try:
            transactions = tuple(base64.b64decode(transaction, validate=True) for transaction in self.transactions)
            signature = bytes.fromhex(self.signature)
        except (binascii.Error, ValueError) as error:
            raise DecodeError("an event's transactions or signature cannot be read") from error
        parents = (bytes.fromhex(self.self_parent) or NO_PARENT, bytes.fromhex(self.other_parent) or NO_PARENT)
        time: Time = self.time_ns
        return Event(self.creator, *parents, time, transactions, signature)


class Gossip(_Model):
    """A message between members: `method` GET asks, POST tells, and a message with a status answers a GET."""

    method: Literal["GET", "POST"] | None = None
    status: Literal[200] | None = None
    path: Literal["/hashgraph/v1/events"] = PATH
    body: GossipBody


class GossipBody(_Model):
    """What its sender knows, and events that the receiver may lack."""

    known: Annotated[tuple[_Hash, ...], Field(max_length=MAX_KNOWN)] = ()
    events: Annotated[tuple[EventMessage, ...], Field(max_length=MAX_EVENTS)] = ()


def encode(message: Gossip) -> bytes:
    """The frame of a message: ASCII JSON, keys sorted, no spaces."""
    data = message.model_dump(mode="json", exclude_none=True)
    return json.dumps(data, sort_keys=True, separators=(",", ":")).encode()


def decode(payload: bytes) -> Gossip:
    """The message in `payload`; any other bytes raise `DecodeError`."""
    if len(payload) > MAX_FRAME_BYTES:
        raise DecodeError(f"{len(payload)} bytes, gossip has at most {MAX_FRAME_BYTES}")
    try:
        message = Gossip.model_validate_json(payload)
    except ValidationError as error:
        raise describe(error) from error
    if (message.method is None) == (message.status is None):
        raise DecodeError("a message has either a method or a status")
    return message
