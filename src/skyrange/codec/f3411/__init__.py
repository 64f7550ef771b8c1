"""ASTM F3411-22a messages: the content of a Remote ID broadcast, encoded and decoded.

`encode(message)` and `decode(body)` are each other's inverse up to the standard's resolution; `faults(message)` lists
what the standard does not allow. `codec.f3411_columns` handles the frequent messages for many aircraft at once.
"""

from skyrange.codec.f3411.decode import decode
from skyrange.codec.f3411.encode import PACK_MOST, SIZE, encode
from skyrange.codec.f3411.faults import faults, is_serial_number
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
    Single,
    Status,
    System,
    UaType,
)
from skyrange.core.errors import DecodeError

__all__ = [
    "EPOCH_2019_S",
    "PACK_MOST",
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
    "Single",
    "Status",
    "System",
    "UaType",
    "decode",
    "encode",
    "faults",
    "is_serial_number",
]
