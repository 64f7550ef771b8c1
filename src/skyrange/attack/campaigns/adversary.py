"""Adversary of a campaign: an object that observes and decides which acts act, and what it knows of aircraft.

The campaign calls it with every frame on a link that it taps, with every Remote ID broadcast that its radio decodes,
and 20 times a second. It has nothing else: no truth.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Final, Protocol, runtime_checkable

from skyrange.attack.contract import Place
from skyrange.codec.f3411 import BasicId, Location, MessagePack
from skyrange.codec.f3411 import decode as decode_remote_id
from skyrange.codec.mavlink import decode, dialect, message_id
from skyrange.codec.remote_id import link_payload
from skyrange.core import elementary_python
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.time import Time


@dataclass(frozen=True, slots=True)
class Observation:
    """A frame that the adversary has read or received."""

    payload: bytes
    """A MAVLink frame of a tapped link, or a Remote ID broadcast as it is on `rid_down` links."""
    link: str | None = None
    """The tapped link, such as `gcs:blue/b1`; `None` for a broadcast."""
    direction: str = "rev"
    """On a tapped link: `fwd` towards the aircraft, `rev` from it."""

    @property
    def vehicle(self) -> str:
        """The aircraft of the tapped link, such as `blue/b1`; "" for a broadcast."""
        return "" if self.link is None else self.link.partition(":")[2]


@dataclass(frozen=True, slots=True)
class CampaignStage:
    """A state of the adversary: its name, in events of the record, and the names of the acts that act in it."""

    name: str
    acts: Collection[str] = ()


@runtime_checkable
class Adversary(Protocol):
    """Decides on the acts of a campaign by what it observes.

    It can be deep-copied (no generators, no closures), takes no random numbers other than from `AttackContext.chance`,
    and reads no clock but `now`.
    """

    def observe(self, now: Time, observation: Observation) -> None:
        """Learn from a frame. It is called from the start of the run, also before the campaign starts, and muted."""
        ...

    def decide(self, now: Time) -> CampaignStage | None:
        """The stage from `now` on; `None` ends the campaign.

        It is called from the start of the campaign on: after each observation and every 50 ms, and again at once when
        it has answered with another stage than before. Acts of the stage start unless they act already, and all others
        stop. An act that has stopped cannot start again.
        """
        ...


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
        return any(elementary_python.distance(observed, place) <= within_m for observed in places)
