"""ASTM F3411-22a messages: the content of a Remote ID broadcast, encoded and decoded.

`encode(message)` and `decode(body)` are each other's inverse up to the standard's resolution; `deviations(message)`
lists what the standard does not allow. `codec.f3411.columns` handles the frequent messages for many aircraft at once.
"""

from skyrange.codec.f3411.conformance import deviations, is_serial_number
from skyrange.codec.f3411.decode import decode
from skyrange.codec.f3411.encode import MAX_PACK_MESSAGES, SIZE, encode
from skyrange.codec.f3411.messages import (
    EPOCH_2019_S,
    PROTOCOL_VERSION,
    Authentication,
    AuthType,
    BasicId,
    Classification,
    DescriptionType,
    HeightType,
    IdType,
    Location,
    Message,
    MessagePack,
    MessageType,
    OperatorId,
    OperatorLocationType,
    Reserved,
    SelfId,
    SingleMessage,
    Status,
    System,
    UaType,
    printable_id,
)
from skyrange.core.errors import DecodeError

__all__ = [
    "EPOCH_2019_S",
    "MAX_PACK_MESSAGES",
    "PROTOCOL_VERSION",
    "SIZE",
    "AuthType",
    "Authentication",
    "BasicId",
    "Classification",
    "DecodeError",
    "DescriptionType",
    "HeightType",
    "IdType",
    "Location",
    "Message",
    "MessagePack",
    "MessageType",
    "OperatorId",
    "OperatorLocationType",
    "Reserved",
    "SelfId",
    "SingleMessage",
    "Status",
    "System",
    "UaType",
    "decode",
    "deviations",
    "encode",
    "is_serial_number",
    "printable_id",
]
