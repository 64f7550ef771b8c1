"""A harmless aircraft on the ground, as shams and floods of Remote ID report it; no aircraft stands there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

from skyrange.attack.contract import Place
from skyrange.codec.f3411 import BasicId, IdType, Location, MessagePack, SelfId, SingleMessage, Status, UaType, encode
from skyrange.codec.f3411.encode import MAX_PACK_MESSAGES, PACK_HEADER, SIZE
from skyrange.core.geodesy import Origin
from skyrange.remoteid.broadcast_profiles import serial_number

LONGEST: Final = PACK_HEADER + MAX_PACK_MESSAGES * SIZE
"""Bytes of the longest body."""


@dataclass(frozen=True, slots=True)
class StandingAircraft:
    """What the aircraft sends: position, identity, and Self-IDs as far as wanted."""

    messages: Sequence[SingleMessage]

    @classmethod
    def at(cls, place: Place, origin: Origin, name: str) -> Self:
        """The aircraft at a place, with the serial number of a node of that name."""
        lat_deg, lon_deg = origin.geodetic_of(place[0], place[1])
        altitude_m = origin.ellipsoid_of(origin.alt_msl_m) + place[2]
        where = Location(status=Status.GROUND, lat_deg=lat_deg, lon_deg=lon_deg, alt_geo_m=altitude_m)
        who = BasicId(IdType.SERIAL_NUMBER, UaType.HELICOPTER_OR_MULTIROTOR, serial_number(name))
        return cls((where, who, *[SelfId(0, "standing here")] * MAX_PACK_MESSAGES))

    def body(self, length: int = LONGEST) -> bytes:
        """A pack of as many messages as fit in a length; its position alone, if no pack fits."""
        if length < PACK_HEADER + SIZE:
            return encode(self.messages[0])
        return encode(MessagePack(tuple(self.messages[: (length - PACK_HEADER) // SIZE])))
