"""Messages of the mission hash: what both ends of a link tell each other in TUNNEL, under a shared key.

TUNNEL (https://mavlink.io/en/messages/common.html#TUNNEL) carries 128 bytes of a type that its users agree on; types
above 32767 are free for experiments.
"""

from __future__ import annotations

import struct
from hashlib import sha256
from hmac import compare_digest
from hmac import new as new_hmac
from typing import Final, NamedTuple

from skyrange.attack.bases.mavlink.orders import read
from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav

PAYLOAD_TYPE: Final = 40_385
"""Payload type of these messages, in the range for experiments."""
COMPONENT: Final = int(mav.MAV_COMP_ID_TUNNEL_NODE)
"""Component id of both ends; a number sequence of its own leaves those of station and autopilot alone."""
TAG_BYTES: Final = 16
"""HMAC-SHA-256 truncated to 128 bits, half of its length as RFC 2104, section 5, recommends at least."""
FRAME_BYTES: Final = 16
"""Bytes of a frame's name, its truncated SHA-256."""
_PAYLOAD: Final = 128
_FORMAT: Final = struct.Struct("<BI16s16s16s")

SENT, ASKED, UNKNOWN = 1, 2, 3
"""Kinds: the station's end has sent that frame; the aircraft's end asks whether it did; it did not."""


class HashMessage(NamedTuple):
    """One message: its kind, the number of the upload or of the question, and the frame that it is about."""

    kind: int
    number: int
    frame: bytes
    upload: bytes = bytes(TAG_BYTES)
    """Of `SENT`: the keyed hash of the upload as far as that frame."""
    tag: bytes = bytes(TAG_BYTES)
    """The keyed hash of all before."""

    def sealed(self, key: bytes) -> HashMessage:
        """The same with its tag."""
        return self._replace(tag=make_tag(key, self.kind, self.number, self.frame, self.upload))

    def is_genuine(self, key: bytes) -> bool:
        """Whether its tag is right."""
        return compare_digest(make_tag(key, self.kind, self.number, self.frame, self.upload), self.tag)


def name_frame(payload: bytes) -> bytes:
    """The name of a frame: its SHA-256, truncated."""
    return sha256(payload).digest()[:FRAME_BYTES]


def derive_key(passphrase: str, vehicle: str) -> bytes:
    """The key of one aircraft (32 bytes): the HMAC-SHA-256 of its id under the passphrase."""
    return new_hmac(passphrase.encode(), vehicle.encode(), sha256).digest()


def make_tag(key: bytes, kind: int, number: int, *parts: bytes) -> bytes:
    """The keyed hash (`TAG_BYTES`) of a message of this kind and number about `parts`; each is told with its length."""
    covered = struct.pack("<BI", kind, number) + b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return new_hmac(key, covered, sha256).digest()[:TAG_BYTES]


def pack_message(packer: Packer, target: int, message: HashMessage) -> bytes:
    """The TUNNEL frame of a message to system `target`."""
    body = _FORMAT.pack(*message)
    padded = list(body.ljust(_PAYLOAD, b"\0"))
    return packer.pack(mav.MAVLink_tunnel_message(target, COMPONENT, PAYLOAD_TYPE, len(body), padded))


def read_message(payload: bytes) -> HashMessage | None:
    """The message in a TUNNEL frame; `None` for every other frame."""
    message = read(payload)
    if message is None or message.get_msgId() != mav.MAVLINK_MSG_ID_TUNNEL or message.payload_type != PAYLOAD_TYPE:
        return None
    if message.payload_length != _FORMAT.size:
        return None
    return HashMessage(*_FORMAT.unpack(bytes(message.payload[: _FORMAT.size])))
