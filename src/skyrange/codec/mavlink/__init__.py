"""MAVLink: frames, streams, signatures, and messages in columns."""

from skyrange.codec.mavlink.deframer import Deframer, DeframerCounts, Piece
from skyrange.codec.mavlink.frames import (
    Message,
    Packer,
    alter,
    decode,
    decode_anew,
    dialect,
    encode_payload,
    message_fields,
    message_id,
    message_name,
    sender_system,
)

__all__ = [
    "Deframer",
    "DeframerCounts",
    "Message",
    "Packer",
    "Piece",
    "alter",
    "decode",
    "decode_anew",
    "dialect",
    "encode_payload",
    "message_fields",
    "message_id",
    "message_name",
    "sender_system",
]
