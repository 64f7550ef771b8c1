"""Knowledge of an adversary: what Remote ID and MAVLink that it received say of aircraft."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from skyrange.attack.campaigns.adversary import Observation
from skyrange.attack.contract import Place
from skyrange.codec.f3411 import BasicId, Location, MessagePack
from skyrange.codec.f3411 import decode as decode_remote_id
from skyrange.codec.mavlink import decode, dialect, message_id
from skyrange.codec.remote_id import link_payload
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin

_NAMES: Final = {number: message.msgname for number, message in dialect.mavlink_map.items()}
_POSITION: Final = dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
_ITEM: Final = dialect.MAVLINK_MSG_ID_MISSION_CURRENT


@dataclass(slots=True)
class Knowledge:
    """What the adversary has observed."""

    origin: Origin
    by_telemetry: dict[str, Place] = field(default_factory=dict)
    """Last position that each aircraft reported on a tapped link, by vehicle id."""
    by_broadcast: dict[str, Place] = field(default_factory=dict)
    """Last position that each UAS ID claimed in a received broadcast."""
    messages: Counter[str] = field(default_factory=Counter)
    """MAVLink messages seen on tapped links, by name."""
    broadcasts: int = 0
    uas_ids: dict[bytes, str] = field(default_factory=dict)
    """Last UAS ID of each sender address: Bluetooth 4 sends it in another broadcast than the position."""
    items: dict[str, int] = field(default_factory=dict)
    """Current mission item of each aircraft, by vehicle id."""

    def read(self, observation: Observation) -> None:
        """Learn from a frame or a broadcast; anything that cannot be decoded is passed over."""
        if observation.link is None:
            self.read_broadcast(observation.payload)
        else:
            self.read_frame(observation.vehicle, observation.payload)

    def read_frame(self, vehicle: str, payload: bytes) -> None:
        """Learn from a frame on a tapped link of an aircraft; anything that is not MAVLink is passed over."""
        number = message_id(payload)
        if number is None or number not in _NAMES:
            return
        self.messages[_NAMES[number]] += 1
        if number not in (_POSITION, _ITEM):
            return
        try:
            message = decode(payload)
        except DecodeError:
            return
        if number == _ITEM:
            self.items[vehicle] = message.seq
            return
        east_m, north_m = self.origin.enu_of(message.lat * 1e-7, message.lon * 1e-7)
        self.by_telemetry[vehicle] = (east_m, north_m, message.alt * 1e-3 - self.origin.alt_msl_m)

    def read_broadcast(self, payload: bytes) -> None:
        """Learn from a received Remote ID broadcast; anything that cannot be decoded is passed over."""
        try:
            header, body = link_payload.unpack(payload)
            message = decode_remote_id(body)
        except DecodeError:
            return
        self.broadcasts += 1
        parts = message.messages if isinstance(message, MessagePack) else (message,)
        for part in parts:
            if isinstance(part, BasicId):
                self.uas_ids[header.address] = part.uas_id
        for part in parts:
            if isinstance(part, Location) and part.lat_deg is not None and part.lon_deg is not None:
                east_m, north_m = self.origin.enu_of(part.lat_deg, part.lon_deg)
                ground_m = self.origin.ellipsoid_of(self.origin.alt_msl_m)
                up_m = part.alt_geo_m - ground_m if part.alt_geo_m is not None else 0.0
                self.by_broadcast[self.uas_ids.get(header.address, "")] = (east_m, north_m, up_m)

    def sees(self, place: Place, within_m: float, *, vehicle: str | None = None, uas_id: str | None = None) -> bool:
        """Whether an aircraft was last observed within `within_m` of a place, in metres.

        It is the one with the telemetry of `vehicle`, the one that broadcasts `uas_id`, or else any that broadcasts.
        """
        if vehicle is not None:
            places = [self.by_telemetry[vehicle]] if vehicle in self.by_telemetry else []
        elif uas_id is not None:
            places = [self.by_broadcast[uas_id]] if uas_id in self.by_broadcast else []
        else:
            places = list(self.by_broadcast.values())
        return any(math.dist(seen, place) <= within_m for seen in places)
